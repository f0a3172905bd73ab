"""Draw the figure of the README: python docs/figure.py FOLDER, a sweep of thesis_learning."""

from __future__ import annotations

import sys
from pathlib import Path

from trl_explore.jobs.reading import find_jobs, read_job
from trl_explore.names import STRATEGIES, strategy_label
from trl_explore.report.figures.axes import handle, legend_above, new_figure, plain_numbers
from trl_explore.report.figures.survival import Row, plot_survival
from trl_explore.report.image_files import inline_svg, theme_css, to_svg
from trl_explore.report.style import KNOWN, visual_language
from trl_explore.statistics.outcomes import Outcomes, convergence_times, judged
from trl_explore.statistics.survival import kaplan_meier

OUT = Path(__file__).with_name("survival.svg")
TITLES = {
    "passed": "Acting: not yet passed",
    "learned": "Learning: not yet learned",
}
"""The measures, and the titles of their panels."""


def row(outcomes: Outcomes) -> Row:
    """The curve of one strategy."""
    times, happened = convergence_times(outcomes)
    name = outcomes.strategy
    return Row(strategy_label(name), kaplan_meier(times, happened), times, KNOWN[name])


def draw(folder: Path) -> str:
    """The share of agents that have not passed, and that have not learned, as SVG.

    Its colours follow the light or dark mode of the screen.
    """
    order = list(STRATEGIES)
    jobs = sorted(map(read_job, find_jobs(folder)), key=lambda job: order.index(job.strategy))
    keys = [handle(KNOWN[job.strategy], strategy_label(job.strategy)) for job in jobs]
    with visual_language():
        figure = new_figure(2.9)
        panels = figure.subplots(1, 2, sharey=True)
        for ax, (measure, title) in zip(panels, TITLES.items(), strict=True):
            rows = [row(judged(job, measure)) for job in jobs]
            plot_survival(ax, rows, time="", title=title, horizon=jobs[0].cap)
            ax.set_xscale("log")
            ax.set_xlim(5, 1.05 * jobs[0].cap)
            ax.set_xlabel("iterations (log)")
            plain_numbers(ax.xaxis)
        legend_above(panels[0], keys, columns=3)
        svg = to_svg(figure)
    shown = inline_svg(
        svg, "survival", "Share of agents that have not yet passed, and that have not yet learned"
    )
    start = shown.index(">") + 1
    xml = shown[:start].replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"')
    return f"{xml}<style>{theme_css([svg])}</style>{shown[start:]}\n"


if __name__ == "__main__":
    OUT.write_text(draw(Path(sys.argv[1])), encoding="utf-8")
