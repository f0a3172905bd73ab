"""The style of all figures: colours, markers and lines of configurations, fonts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
from matplotlib.colors import rgb_to_hsv, to_hex, to_rgb

from trl_explore.names import STRATEGIES

INK, MUTED, GRID, PAPER = "#1c1e21", "#5f6670", "#dfe2e6", "#ffffff"
MAP = tuple(to_hex(mpl.colormaps["cividis"](k / 20)) for k in range(21))
"""Colours of map cells, the same on light and dark screens. *cividis* looks nearly the same with
and without colour vision deficiency (Nuñez, Anderton & Renslow, PLoS ONE 13, 2018)."""
MAP_INKS = ("#101214", "#fdfdfe")
"""Text colours in map cells."""
DARK_PAPER, MIN_CONTRAST = "#171a1f", 4.0
"""Background of a dark screen, and the minimum contrast of every colour to it."""
WIDTH = 4.8
"""Width of a figure in inches; on a phone, a point of text is about a pixel."""

LineStyle = str | tuple[int, tuple[float, ...]]


@dataclass(frozen=True)
class Style:
    """How one configuration looks."""

    color: str
    marker: str
    line: LineStyle


_DASH: LineStyle = (0, (5.0, 2.0))
_DOT: LineStyle = (0, (1.2, 1.6))
_DASH_DOT: LineStyle = (0, (5.0, 1.6, 1.2, 1.6))
_LONG: LineStyle = (0, (9.0, 2.5))
_DASH_DOT_DOT: LineStyle = (0, (6.0, 1.5, 1.2, 1.5, 1.2, 1.5))
_NAMED: Mapping[str, LineStyle] = {
    "solid": "-",
    "dashes": _DASH,
    "dots": _DOT,
    "dash-dot": _DASH_DOT,
    "long dashes": _LONG,
    "dash-dot-dot": _DASH_DOT_DOT,
}

KNOWN: Mapping[str, Style] = {
    name: Style(entry.look[0], entry.look[1], _NAMED[entry.look[2]])
    for name, entry in STRATEGIES.items()
    if entry.look is not None
}
"""The strategies that look the same in every report."""
FURTHER: Sequence[Style] = (
    Style("#6b3410", "P", "-"),
    Style("#0891ad", "X", _DASH),
    Style("#4a0acc", "<", _DOT),
    Style("#c8504f", ">", _DASH_DOT),
    Style("#05056b", "h", _LONG),
    Style("#4f7a28", "p", _DASH_DOT_DOT),
    Style("#2340b8", "d", "-"),
)
MARKERS = "o^sDvPX<>hpd"
LINES: Sequence[LineStyle] = ("-", _DASH, _DASH_DOT, _LONG, _DASH_DOT_DOT)


def styles(strategies: Sequence[str]) -> list[Style]:
    """One style for each configuration of a figure, given its strategy [n].

    A strategy's only configuration has the style of the strategy. Several configurations of one
    strategy have a ramp of colours, in the strategy's hue if there are other strategies. Among
    twelve configurations, no two share both marker and line.
    """
    unknown = [name for name in dict.fromkeys(strategies) if name not in KNOWN]
    base = dict(KNOWN) | {n: FURTHER[i % len(FURTHER)] for i, n in enumerate(sorted(unknown))}
    only = len(set(strategies)) == 1
    used: dict[str, int] = {}
    taken: set[tuple[str, LineStyle]] = set()
    result = []
    for name in strategies:
        count, k = strategies.count(name), used.get(name, 0)
        used[name] = k + 1
        style = base[name]
        if count > 1:
            color = ramp(k, count) if only else shade(style.color, k, count)
            lines = LINES if only else (style.line,)
            marker = MARKERS[k % len(MARKERS)] if only else style.marker
            style = Style(color, marker, lines[k % len(lines)])
        style = _free(style, taken)
        taken.add((style.marker, style.line))
        result.append(style)
    return result


OPTIONS: Sequence[Style] = (
    Style(INK, "o", "-"),
    Style("#c28100", "D", _DASH),
    Style("#3b2f8f", "^", _DASH_DOT),
    Style("#4a9fd8", "v", _DOT),
    Style("#7a1f3d", "s", _LONG),
    Style("#4f7a28", "P", _DASH_DOT_DOT),
)
"""Styles of options, used if strategies have separate panels or blocks; the first is for the
option that the others are compared with."""


def option_styles(count: int) -> list[Style]:
    """One style per option.

    >>> [style.marker for style in option_styles(3)]
    ['o', 'D', '^']
    """
    return list(OPTIONS[:count]) + styles([f"option{k}" for k in range(count - len(OPTIONS))])


def _free(style: Style, taken: set[tuple[str, LineStyle]]) -> Style:
    """The style with the next combination of marker and line that is not taken."""
    start = MARKERS.index(style.marker)
    for line in (style.line, *LINES):
        for step in range(len(MARKERS)):
            marker = MARKERS[(start + step) % len(MARKERS)]
            if (marker, line) not in taken:
                return Style(style.color, marker, line)
    return style


def ramp(k: int, count: int) -> str:
    """Colour k of a ramp from dark violet to light olive that also works in greyscale."""
    position = 0.08 + 0.70 * k / max(1, count - 1)
    return to_hex(mpl.colormaps["viridis"](position))


def shade(color: str, k: int, count: int) -> str:
    """Shade k of a colour, from darker to lighter."""
    amount = -0.45 + 0.85 * k / max(1, count - 1)
    target = 0.0 if amount < 0 else 1.0
    red, green, blue = (c + (target - c) * abs(amount) for c in to_rgb(color))
    return to_hex((red, green, blue))


_SETTINGS: Mapping[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.titley": 1.0,  # no ticks above a panel: no search for a free place
    "axes.labelsize": 9,
    "axes.labelcolor": INK,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.facecolor": PAPER,
    "axes.unicode_minus": True,
    "figure.facecolor": PAPER,
    "savefig.facecolor": PAPER,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "text.color": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 9,
    "ytick.labelsize": 9,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "lines.linewidth": 1.7,
    "lines.markersize": 4.5,
    "svg.fonttype": "path",
    "svg.hashsalt": "trl_explore",
    "text.parse_math": False,
    "figure.dpi": 100,
}


@contextmanager
def visual_language() -> Iterator[None]:
    """Draw with the fonts, lines and colours of the report inside this context."""
    with mpl.rc_context():
        mpl.rcdefaults()
        for name, value in _SETTINGS.items():
            mpl.rcParams[name] = value  # type: ignore[index]
        yield


def dark_variant(color: str) -> str:
    """The colour on a dark background: greys are inverted, hues lightened until they contrast.

    >>> dark_variant("#ffffff") == DARK_PAPER
    True
    """
    rgb = to_rgb(color)
    if rgb_to_hsv(rgb)[1] < 0.2:
        grey = sum(rgb) / 3
        paper, ink = to_rgb(DARK_PAPER), 0.93
        red, green, blue = (ink + (p - ink) * grey for p in paper)
        return to_hex((red, green, blue))
    step = 0
    while contrast(to_hex(rgb), DARK_PAPER) < MIN_CONTRAST and step < 40:
        red, green, blue = (c + (1.0 - c) * 0.06 for c in rgb)
        rgb = (red, green, blue)
        step += 1
    return to_hex(rgb)


def contrast(a: str, b: str) -> float:
    """Contrast ratio of two colours, 1 to 21.

    Source: Web Content Accessibility Guidelines 2.2, relative luminance.

    >>> round(contrast("#000000", "#ffffff"), 1)
    21.0
    """
    high, low = sorted((_luminance(a), _luminance(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def _luminance(color: str) -> float:
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(color)]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
