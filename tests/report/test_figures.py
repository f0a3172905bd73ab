"""Each figure function on arrays: what is drawn, with which labels and units."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure

from trl_explore.report.curves import Curve
from trl_explore.report.figures import by_parameter, differences, learning, maps, survival, trials
from trl_explore.report.figures.by_parameter import plot_epsilon
from trl_explore.report.figures.panels import plot_curves
from trl_explore.report.style import KNOWN, MAP, OPTIONS, PAPER, contrast, visual_language
from trl_explore.statistics.estimates import Estimate
from trl_explore.statistics.power import detectable_difference
from trl_explore.statistics.survival import kaplan_meier

SOFTMAX, RANDOM = KNOWN["softmax"], KNOWN["random"]


@pytest.fixture
def ax() -> Iterator[Axes]:
    with visual_language():
        yield Figure(figsize=(5, 3), layout="constrained").subplots()


def texts(ax: Axes) -> list[str]:
    return [t.get_text() for t in ax.texts]


def legend(ax: Axes) -> list[str]:
    return [t.get_text() for box in ax.figure.legends for t in box.get_texts()]


def row(values, status, label="softmax"):
    return trials.Row(label, np.array(values, dtype=float), np.array(status), SOFTMAX)


def points(ax: Axes, status: str) -> list[PathCollection]:
    return [c for c in ax.collections if c.get_label() == status and isinstance(c, PathCollection)]


def test_trials_draws_every_trial_at_its_value(ax):
    trials.plot_trials(ax, [row([150, 1000, 170], ["converged", "capped", "converged"])],
                       quantity="iterations to convergence")  # fmt: skip
    (filled,), (hollow,) = points(ax, "converged"), points(ax, "capped")
    assert sorted(np.asarray(filled.get_offsets())[:, 0]) == [150, 170]
    assert np.asarray(hollow.get_offsets())[:, 0].tolist() == [1000]


def test_trials_marks_capped_trials_as_such(ax):
    from matplotlib.colors import to_hex

    trials.plot_trials(ax, [row([150, 1000], ["converged", "capped"])], quantity="iterations")
    assert to_hex(points(ax, "capped")[0].get_facecolor()[0]) == PAPER
    assert to_hex(points(ax, "capped")[0].get_edgecolor()[0]) == SOFTMAX.color
    assert to_hex(points(ax, "converged")[0].get_facecolor()[0]) == SOFTMAX.color
    assert "stopped at the cap, not passed" in legend(ax)
    assert "1/2" in texts(ax)


def test_trials_names_only_what_it_shows(ax):
    trials.plot_trials(ax, [row([150, 160], ["converged"] * 2)], quantity="iterations")
    assert legend(ax) == ["converged: passed the task", "median and middle half"]


def test_trials_draws_threshold_and_axis_names(ax):
    trials.plot_trials(ax, [row([20, 196], ["capped", "converged"])], quantity="mean score",
                       of="ε", line=(195.0, "passes above 195"))  # fmt: skip
    assert any(line.get_xdata()[0] == 195.0 for line in ax.lines if len(line.get_xdata()) == 2)
    assert "passes above 195" in legend(ax)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("mean score", "ε")
    assert [t.get_text() for t in ax.get_yticklabels()] == ["softmax"]


def test_trials_draws_median_and_quartiles(ax):
    trials.plot_trials(ax, [row([1, 2, 3, 4], ["converged"] * 4)], quantity="s")
    spans = [sorted(line.get_xdata()) for line in ax.lines]
    assert [1.0, 3.0] in spans
    assert [2.0] in spans


def test_trials_is_logarithmic_where_values_span_much(ax):
    trials.plot_trials(ax, [row([1, 100], ["converged"] * 2)], quantity="seconds")
    assert ax.get_xscale() == "log"
    assert ax.get_xlabel() == "seconds (logarithmic)"


def test_trials_leaves_out_what_is_not_finite_and_crosses_diverged_ones(ax):
    trials.plot_trials(ax, [row([np.nan, 50], ["diverged", "diverged"])], quantity="score")
    (crosses,) = points(ax, "diverged")
    assert len(crosses.get_offsets()) == 1
    assert "diverged" in legend(ax)


def test_a_thousand_trials_are_an_image(ax):
    many = row(np.linspace(100, 900, 1000), ["converged"] * 1000)
    trials.plot_trials(ax, [many], quantity="iterations")
    assert points(ax, "converged")[0].get_rasterized()


def test_the_cloud_of_many_points_is_wide_where_they_are():
    values = np.concatenate([np.full(300, 150.0), np.full(150, 500.0), np.linspace(800, 900, 20)])
    width = trials.crowding(values)
    assert width[0] == 1.0
    assert width[300] == pytest.approx(0.5**0.5)
    assert width[-1] < 0.2
    assert (trials.crowding(values[:50]) == 1.0).all()


def test_survival_draws_the_curve_and_its_band(ax):
    durations = np.array([100.0, 200.0, 300.0, 1000.0])
    curve = kaplan_meier(durations, [True, True, True, False])
    survival.plot_survival(ax, [survival.Row("softmax", curve, durations, SOFTMAX)],
                           time="iterations")  # fmt: skip
    step = ax.lines[0]
    assert step.get_drawstyle() == "steps-post"
    assert list(zip(step.get_xdata(), step.get_ydata(), strict=True))[:5] == [
        (0, 1), (100, 0.75), (200, 0.5), (300, 0.25), (1000, 0.25)
    ]  # fmt: skip
    assert len(ax.collections) == 1
    assert (ax.get_xlabel(), ax.get_title(loc="left")) == ("iterations", "trials not yet converged")


def test_survival_of_many_has_no_bands(ax):
    durations = np.array([100.0, 200.0])
    curve = kaplan_meier(durations, [True, True])
    rows = [survival.Row(str(k), curve, durations, SOFTMAX) for k in range(7)]
    survival.plot_survival(ax, rows, time="iterations")
    assert len(ax.collections) == 0


def test_survival_is_logarithmic_where_times_span_much(ax):
    durations = np.array([100.0, 200.0, 5000.0])
    curve = kaplan_meier(durations, [True, True, False])
    survival.plot_survival(ax, [survival.Row("softmax", curve, durations, SOFTMAX)],
                           time="iterations")  # fmt: skip
    assert ax.get_xscale() == "log"
    assert ax.get_xlim() == pytest.approx((80.0, 5250.0))
    assert ax.get_xlabel() == "iterations (logarithmic)"


def test_numbers_at_risk_are_those_counted_by_hand(ax):
    durations = np.array([100.0, 200.0, 300.0, 1000.0])
    curve = kaplan_meier(durations, [True, True, True, False])
    rows = [survival.Row("softmax", curve, durations, SOFTMAX)]
    survival.plot_numbers_at_risk(ax, rows, [0, 150, 200, 1000])
    assert texts(ax) == ["still learning", "softmax", "4", "3", "3", "1"]


def test_learning_draws_mean_band_threshold_and_the_others(ax):
    x = np.array([1.0, 2.0, 3.0])
    mine, other = Curve(x, np.array([10.0, 20.0, 30.0]), x, x + 40), Curve(x, np.full(3, 9.0))
    learning.plot_learning(ax, mine, SOFTMAX, title="softmax", others=[(other, RANDOM)],
                           threshold=195.0)  # fmt: skip
    drawn = [tuple(np.asarray(line.get_ydata(), dtype=float)) for line in ax.lines]
    assert drawn == [(9, 9, 9), (10, 20, 30), (195, 195)]
    assert len(ax.collections) == 1
    assert ax.get_title(loc="left") == "softmax"


def test_forest_fills_only_significant_differences(ax):
    rows = [
        differences.PairRow(
            "softmax", "random", Estimate(852.0, 830.0, 870.0, 0.95), True, SOFTMAX
        ),
        differences.PairRow("softmax", "argmax", Estimate(10.0, -5.0, 25.0, 0.95), False, SOFTMAX),
    ]
    differences.plot_forest(ax, rows)
    marked = {line.get_label(): line for line in ax.lines}
    assert marked["significant"].get_markerfacecolor() == SOFTMAX.color
    assert marked["not significant"].get_markerfacecolor() == PAPER
    assert marked["not significant"].get_xdata() == [10.0]
    assert any(list(line.get_xdata()) == [830.0, 870.0] for line in ax.lines)
    assert ax.get_xlabel() == "iterations that the first saves"
    assert [t.get_text() for t in ax.get_yticklabels()] == ["softmax vs. random",
                                                            "softmax vs. argmax"]  # fmt: skip


def test_power_line_is_the_detectable_difference(ax):
    pairs = [
        by_parameter.Pair("a vs. b", 100.0, 50.0, True),
        by_parameter.Pair("a vs. c", 100.0, 5.0, False),
    ]
    by_parameter.plot_power(ax, pairs, trials=30, level=0.95)
    n, y = ax.lines[0].get_data()
    assert np.allclose(y, detectable_difference(100.0, n))
    # 32 trials find half a standard deviation (see the docstring of trials_for_difference).
    assert ([32], [50.0]) in [tuple(map(list, line.get_data())) for line in ax.lines]
    assert ax.get_xscale() == ax.get_yscale() == "log"
    assert "this study: 30 trials" in legend(ax)
    assert ax.get_ylabel() == "difference in iterations (logarithmic)"


def test_epsilon_curve_is_a_power(ax):
    plot_epsilon(ax, [0.5, 0.99], [SOFTMAX, RANDOM], iterations=100, emphasised=0.99)
    assert np.allclose(np.asarray(ax.lines[0].get_ydata())[:3], [1.0, 0.5, 0.25])
    assert ax.lines[1].get_linewidth() > ax.lines[0].get_linewidth()
    assert legend(ax) == ["0.5", "0.99"]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("iteration", "ε: probability of a random action")


def test_a_map_states_every_value_in_an_ink_that_stands_out(ax):
    values = np.array([[0.0, 50.0], [100.0, np.nan]])
    maps.plot_plane(ax, values, [0.0, 0.1], [0.5, 1.0], x="ε", y="T", scale=(0.0, 100.0),
                     marked=(0, 1))  # fmt: skip
    assert texts(ax) == ["0", "50", "100"]
    assert [t.get_position() for t in ax.texts] == [(0, 0), (0, 1), (1, 0)]
    from matplotlib.colors import to_hex
    from matplotlib.patches import Rectangle

    squares = [p for p in ax.patches if isinstance(p, Rectangle)]
    assert [to_hex(p.get_facecolor()) for p in squares[:3]] == [MAP[0], MAP[10], MAP[20]]
    assert len(squares) == 4  # three cells and a frame
    for square, text in zip(squares, ax.texts, strict=False):
        assert contrast(to_hex(square.get_facecolor()), to_hex(text.get_color())) >= 4.4
    assert [t.get_text() for t in ax.get_xticklabels()] == ["0", "0.1"]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("ε", "T")


def test_every_cell_of_a_map_can_be_read():
    # Between black and white no grey gives more than 4.58 to both.
    assert all(contrast(color, maps.ink_on(color)) >= 4.4 for color in MAP)


def test_effects_stand_block_by_block(ax):
    dots = [
        differences.Dot(0, 0, Estimate(40.0, 30.0, 50.0, 0.95), OPTIONS[0]),
        differences.Dot(1, 1, Estimate(90.0, np.nan, np.nan, 0.95), OPTIONS[1]),
    ]
    differences.plot_effects(ax, dots, ["argmax", "softmax"], 2, quantity="trials that pass, %")
    drawn = [(list(line.get_xdata()), float(line.get_ydata()[0])) for line in ax.lines]
    assert ([30.0, 50.0], 0.0) in drawn
    assert ([40.0], 0.0) in drawn
    # Block 1 begins after two options and a gap of 0.9; its second place is one below.
    assert ([90.0], pytest.approx(3.9)) in drawn
    assert [t.get_text() for t in ax.get_yticklabels()] == ["argmax", "softmax"]
    assert ax.get_yticks().tolist() == pytest.approx([0.5, 3.4])


def test_curves_have_bands_where_they_are_few(ax):
    x = np.array([1.0, 2.0, 3.0])
    rows = [(Curve(x, x, x - 1, x + 1), OPTIONS[k]) for k in range(3)]
    plot_curves(ax, rows, title="ε-greedy", line=2.5)
    assert len(ax.collections) == 3
    assert ax.get_ylim() == (0.0, pytest.approx(4.2))
    assert ax.get_title(loc="left") == "ε-greedy"


def test_panels_of_survival_end_together(ax):
    durations = np.array([100.0, 200.0])
    rows = [survival.Row("x", kaplan_meier(durations, [True, True]), durations, SOFTMAX)]
    survival.plot_survival(ax, rows, time="", title="softmax", horizon=1000.0)
    assert ax.get_xlim() == (0.0, pytest.approx(1020.0))
    assert ax.lines[0].get_xdata()[-1] == 1000.0
