"""The figure: frames per second against the number of trials."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullLocator
from plan import SIZES, Measured

from trl_explore.report.image_files import to_png, to_svg
from trl_explore.report.style import FURTHER, INK, KNOWN, WIDTH, visual_language

LINES = (
    ("fused", 2, "fused, 2 threads", KNOWN["softmax"].color, "D"),
    ("fused", 1, "fused, 1 thread", KNOWN["epsilon_greedy"].color, "o"),
    ("plain", 1, "plain loop", KNOWN["argmax"].color, "s"),
    ("lanes", 1, "TorchRL, lanes", KNOWN["decaying_epsilon_greedy"].color, "^"),
    ("stock", 1, "TorchRL, stock", FURTHER[0].color, "v"),
)
"""Kind, threads, label, colour and marker, from top to bottom."""
DASHED = (0, (5.0, 2.0))
ALONE = ("plain", "stock")
"""Kinds that run one trial after the other; their speed does not depend on the number of trials."""


def scaling(m: Measured) -> Figure:
    """Frames per second against the number of trials, both on log scales."""
    with visual_language():
        figure = Figure(figsize=(WIDTH, 3.6), layout="constrained")
        axes = figure.add_subplot()
        axes.set_xscale("log")
        axes.set_yscale("log")
        for kind, threads, label, color, marker in LINES:
            points = [
                (case.trials, m.speed(case))
                for case in m.runs
                if (case.kind, case.threads, case.strategy) == (kind, threads, "softmax")
            ]
            if not points:
                continue
            x, y = zip(*sorted(points), strict=True)
            line = DASHED if kind in ALONE else "-"
            if kind in ALONE:
                axes.axhline(y[0], color=color, linestyle=line)
            axes.plot(x, y, color=color, marker=marker, linestyle=line, label=label)
        axes.set_xticks(SIZES)
        axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:,.0f}"))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(FuncFormatter(lambda y, _: _short(y)))
        axes.set_xlabel("trials")
        axes.set_ylabel("frames per second")
        axes.grid(True, axis="y")
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), labelcolor=INK)
        return figure


def _short(y: float) -> str:
    for size, suffix in ((1e6, " M"), (1e3, " k")):
        if y >= size:
            return f"{y / size:g}{suffix}"
    return f"{y:g}"


def write(m: Measured, folder: Path) -> str:
    """Write the figure to ``scaling.svg`` and ``scaling.png``; return the name of the first."""
    figure = scaling(m)
    with visual_language():
        (folder / "scaling.svg").write_text(to_svg(figure), encoding="utf-8")
        (folder / "scaling.png").write_bytes(to_png(figure))
    return "scaling.svg"
