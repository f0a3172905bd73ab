"""The layout of configurations, and their labels and styles in it."""

import numpy as np

from trl_explore.report.groups import group_jobs
from trl_explore.report.labels import configuration_labels, natural_order, swept_parameters
from trl_explore.report.layouts import crossed, plane
from trl_explore.report.loading import load
from trl_explore.report.style import styles


def cells(make):
    return natural_order(
        [
            make([200], name=f"{s},{c}", strategy=s, groups={"correction": c})
            for c in ("PerStep", "NoCorrection")
            for s in ("softmax", "argmax")
        ]
    )


def test_options_are_named_in_words_and_that_of_the_thesis_comes_first(make):
    labels = configuration_labels(cells(make))
    assert list(labels.values()) == [
        "argmax, uncorrected", "argmax, per-step ratio",
        "softmax, uncorrected", "softmax, per-step ratio",
    ]  # fmt: skip


def test_rows_are_crossed_with_options(make):
    layout = crossed(cells(make))
    assert layout is not None
    assert (layout.of, layout.rows) == ("correction", ("argmax", "softmax"))
    assert layout.options == ("uncorrected", "per-step ratio")
    assert layout.pairs() == [
        ("argmax,NoCorrection", "argmax,PerStep"), ("softmax,NoCorrection", "softmax,PerStep")
    ]  # fmt: skip


def test_a_missing_cell_stays_empty(make):
    layout = crossed(cells(make)[:3])
    assert layout is not None
    assert set(layout.cells) == {(0, 0), (0, 1), (1, 0)}
    assert len(layout.pairs()) == 1


def test_temperatures_are_rows_too(make):
    jobs = [
        make([200], name=f"{t},{c}", parameters={"temperature": t}, groups={"correction": c})
        for t in (1.0, 0.5)
        for c in ("NoCorrection", "Behaviour")
    ]
    layout = crossed(natural_order(jobs))
    assert layout is not None
    assert layout.rows == ("T = 0.5", "T = 1")
    assert layout.options == ("uncorrected", "gradient of μ")


def test_options_of_one_row_or_two_groups_are_no_cross(make):
    assert crossed([make([200], name=c, groups={"correction": c})
                    for c in ("NoCorrection", "PerStep")]) is None  # fmt: skip
    both = [
        make([200], name=f"{s}{c}{b}", strategy=s, groups={"correction": c, "baseline": b})
        for s in ("softmax", "argmax")
        for c, b in (("NoCorrection", "Constant"), ("PerStep", "Constant"),
                     ("NoCorrection", "StepMean"))
    ]  # fmt: skip
    assert crossed(both) is None
    assert len(set(configuration_labels(both).values())) == len(both)


def test_arguments_of_different_classes_are_no_parameters(make):
    from dataclasses import replace

    def job(name, **arguments):
        c = make([200], name=name)
        return replace(c, config={"correction": {"_target_": f"x.{name}", **arguments}})

    jobs = [job("NoCorrection"), job("PerStep", clip=None, self_normalize=False)]
    assert list(configuration_labels(jobs).values()) == ["uncorrected", "per-step ratio"]
    clips = [job("PerStep", clip=None), replace(job("PerStep", clip=2.0), name="other")]
    assert list(configuration_labels(clips).values()) == ["clip = None", "clip = 2"]


def test_a_constant_baseline_states_its_value(make):
    from dataclasses import replace

    jobs = [
        replace(
            make([200], name=str(v)), config={"baseline": {"_target_": "x.Constant", "value": v}}
        )
        for v in (0.0, 20.0)
    ]
    assert list(configuration_labels(jobs).values()) == ["baseline = 0", "baseline = 20"]
    jobs.append(replace(make([200], name="m"), config={"baseline": {"_target_": "x.StepMean"}}))
    assert list(configuration_labels(jobs).values()) == [
        "no baseline", "baseline 20", "mean by step"
    ]  # fmt: skip


def test_two_numbers_make_a_plane(make):
    jobs = [
        make([200], name=f"{e},{t}", strategy="epsilon_softmax",
             parameters={"epsilon": e, "temperature": t})
        for e in (0.3, 0.0, 0.1)
        for t in (1.0, 0.5, 2.0)
    ]  # fmt: skip
    assert swept_parameters(jobs) == ["epsilon", "temperature"]
    layout = plane(jobs)
    assert layout is not None
    assert (layout.x, layout.y, layout.xs, layout.ys) == ("ε", "T", (0, 0.1, 0.3), (0.5, 1, 2))
    assert layout.reference == layout.cells[0, 1] == "0.0,1.0"
    assert len(layout.pairs()) == 8
    assert plane(jobs[:2]) is None
    without = plane([job for job in jobs if job.name != "0.0,1.0"])
    assert without is not None
    assert without.pairs() == []


def test_an_option_looks_the_same_in_every_row(layouts):
    groups = {g.experiment: g for g in group_jobs(load([layouts]).jobs)}
    group = groups["corrections"]
    assert group.crossed is not None
    by_option = {}
    for (_, option), name in group.crossed.cells.items():
        by_option.setdefault(option, set()).add(group.styles[name])
    assert all(len(looks) == 1 for looks in by_option.values())
    assert len({next(iter(looks)).color for looks in by_option.values()}) == 3
    assert groups["mixture_plane"].plane is not None
    assert groups["mixture_plane"].title == "The plane of ε and temperature"


def test_a_strategy_beside_others_keeps_its_look(make):
    group = [make([200], strategy=s, name=s) for s in ("softmax", "argmax")]
    assert crossed(group) is None
    assert len(np.unique([s.marker for s in styles(["softmax", "argmax"])])) == 2
