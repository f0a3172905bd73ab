"""The figures as they stand in the report: no text over another, none cut off."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from tests.report.conftest import write_crossing
from tests.report.test_sizes import write_sizes
from tests.report.test_visits import write_visits
from trl_explore.report.evidence import Evidence, GroupEvidence, gather
from trl_explore.report.figures import KINDS, draw_all
from trl_explore.report.figures.differences import draw_acting, oriented
from trl_explore.report.figures.survival import draw_survival
from trl_explore.report.loading import load
from trl_explore.report.style import visual_language


@pytest.fixture(scope="module")
def study(made) -> list[GroupEvidence]:
    return gather(load([made.study])).groups


@pytest.fixture(scope="module")
def twelve(tmp_path_factory, make_job) -> GroupEvidence:
    folder: Path = tmp_path_factory.mktemp("twelve") / "train"
    rng = np.random.default_rng(3)
    for k in range(12):
        make_job(folder, f"s{k:02d}", rng.integers(100, 999, 6), strategy=f"a_long_strategy_{k}")
    return gather(load([folder])).groups[0]


@pytest.fixture(scope="module")
def laid_out(layouts) -> list[GroupEvidence]:
    return gather(load([layouts])).groups


def boxes(figure: Figure) -> list[tuple[str, Any]]:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    shown = [t for t in figure.findobj(Text) if t.get_visible() and t.get_text().strip()]
    # Ticks beyond the limits exist, but are not drawn.
    found = [(t.get_text(), t.get_window_extent(renderer)) for t in shown if _drawn(t, figure)]
    return [(text, box) for text, box in found if box.width > 0]


def _drawn(text: Text, figure: Figure) -> bool:
    for ax in figure.axes:
        for axis in (ax.xaxis, ax.yaxis):
            ticks = [*axis.get_major_ticks(), *axis.get_minor_ticks()]
            if any(text in (t.label1, t.label2) for t in ticks):
                low, high = sorted(axis.get_view_interval())
                position = text.get_position()[0 if axis is ax.xaxis else 1]
                return low <= position <= high and ax.axison
    return True


def check(figure: Figure) -> None:
    found = boxes(figure)
    assert len(found) > 4
    for (a, x), (b, y) in combinations(found, 2):
        assert not x.padded(-1.0).overlaps(y.padded(-1.0)), f"{a!r} lies on {b!r}"
    width, height = figure.get_size_inches() * figure.dpi
    for text, box in found:
        inside = box.x0 >= -1 and box.x1 <= width + 1 and box.y0 >= -1 and box.y1 <= height + 1
        assert inside, f"{text!r} is cut off"


@pytest.fixture(scope="module")
def by_learning(tmp_path_factory, make_job) -> Evidence:
    """Strategies alone, and crossed with the bias of their gradient, by both measures."""
    folder: Path = tmp_path_factory.mktemp("learned")
    write_crossing(folder / "corrections", trials=8)
    for strategy in ("random", "argmax", "decaying_epsilon_greedy"):
        learned = [None, *range(30, 65, 5)]
        make_job(folder / "thesis", strategy, [1000, *range(140, 210, 10)], strategy=strategy,
                 learned=learned)  # fmt: skip
    return gather(load([folder]))


@pytest.fixture(scope="module")
def sized(tmp_path_factory, make_job) -> list[GroupEvidence]:
    """A task of several sizes, and one with a record of where the trials have been."""
    folder: Path = tmp_path_factory.mktemp("sized")
    job = make_job(folder / "maps", "softmax", [100, 120], env="FrozenLake-v1")
    write_visits(job)
    return [write_sizes(folder, make_job), *gather(load([job])).groups]


def test_no_text_lies_on_another_in_the_figure_of_why(by_learning):
    with visual_language():
        check(draw_acting(by_learning.decompositions)[0])


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.name)
def test_no_text_lies_on_another_in_any_figure(study, laid_out, by_learning, sized, kind):
    drawn = 0
    for part in [*study, *laid_out, *by_learning.groups, *sized]:
        if kind.applies(part):
            with visual_language():
                check(kind.draw(part)[0])
            drawn += 1
    assert drawn


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.name)
def test_no_text_lies_on_another_with_twelve_strategies(twelve, kind):
    if kind.applies(twelve):
        with visual_language():
            check(kind.draw(twelve)[0])


def test_long_runs_have_room_for_their_numbers(tmp_path, make_job):
    for strategy in ("softmax", "argmax"):
        for correction in ("NoCorrection", "PerStep"):
            make_job(tmp_path / "lake", f"{strategy},{correction}", [800, 9000, 10000], cap=10000,
                     strategy=strategy, groups={"correction": correction})  # fmt: skip
    (part,) = gather(load([tmp_path])).groups
    for kind in KINDS:
        if kind.applies(part):
            with visual_language():
                check(kind.draw(part)[0])


def test_every_figure_of_the_thesis_is_drawn(made):
    # Seconds of the decay grid were not measured here.
    names = [path.stem for path in (made.out / "figures").glob("*.svg")]
    numbers = []
    for kind in KINDS:
        for experiment, number in kind.thesis.items():
            name = f"{experiment}-{number.replace('.', '_')}-{kind.name}"
            assert (name in names) == (number != "2.4")
            numbers.append(number)
    assert sorted(numbers) == ["2.1", "2.2", "2.3", "2.4", "2.5", "3.1", "3.2", "3.3"]


def test_captions_and_alternative_texts_carry_the_numbers(study):
    figures = {figure.kind.name: figure for figure in draw_all(study[0])}
    assert "random: 0 of 12" in figures["score"].caption
    assert "random: not reached" in figures["iterations"].caption
    assert all(figure.caption in figure.alt and len(figure.alt) > 60 for figure in figures.values())


def test_in_frames_failed_trials_stay_to_the_end_of_the_common_axis(study):
    with visual_language():
        figure = draw_survival(study[0], "frames")
    random = next(c for c in study[0].group.configurations if c.strategy == "random")
    risk = [t.get_text() for t in figure.axes[1].texts]
    first = risk.index("random") + 1
    assert set(risk[first : first + 3]) == {str(len(random))}


def test_pairs_are_turned_so_that_the_first_is_the_faster(study):
    for comparison in study[0].comparisons:
        first, second, difference = oriented(comparison)
        assert difference.value >= 0
        assert difference.low <= difference.high
        by_name = {c.name: c.durations.mean() for c in study[0].group.configurations}
        assert by_name[first] <= by_name[second]
