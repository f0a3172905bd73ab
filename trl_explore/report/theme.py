"""A figure inside the page: its ids made unique, its colours those of the reader's theme."""

from __future__ import annotations

import re
from collections.abc import Iterable
from html import escape

from matplotlib.colors import rgb_to_hsv, to_hex, to_rgb

from trl_explore.report.style import MAP, MAP_INKS

FIXED = frozenset((*MAP, *MAP_INKS))
"""Colours that stay as they are: those of a map, whose ink is chosen for its cells."""
DARK_PAPER = "#171a1f"
MIN_CONTRAST = 4.0
_COLOR = re.compile(r"#[0-9a-f]{6}\b")


def inline_svg(svg: str, name: str, alt: str) -> str:
    """The drawing as an element of a page, with an alternative text.

    Args:
        svg: from :func:`trl_explore.report.render.to_svg`.
        name: unique within the page; put before every id.
        alt: what the figure shows, plain text.

    """
    body = svg[svg.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.S)
    body = re.sub(r"<style type=\"text/css\">.*?</style>", "", body, flags=re.S)
    body = re.sub(r"<!--.*?-->", "", body, flags=re.S)
    body = re.sub(r'\b(id="|href="#|url\(#)', lambda m: f"{m[1]}{name}-", body)
    body = re.sub(r'style="([^"]*)"', lambda m: f'style="{_COLOR.sub(_variable, m[1])}"', body)
    opening = body[: body.index(">") + 1]
    size = re.search(r'viewBox="[^"]*"', opening)
    start = f'<svg xmlns:xlink="http://www.w3.org/1999/xlink" {size[0] if size else ""}'
    return f'{start} role="img" aria-label="{escape(alt)}">{body[len(opening) :].rstrip()}'


def theme_css(svgs: Iterable[str]) -> str:
    """The variables of all colours that the drawings use, for light and for dark screens."""
    colors = sorted({c for svg in svgs for c in _COLOR.findall(svg)} - FIXED)
    light = "".join(f"--c{c[1:]}:{c};" for c in colors)
    dark = "".join(f"--c{c[1:]}:{dark_variant(c)};" for c in colors)
    return f":root{{{light}}}@media screen and (prefers-color-scheme:dark){{:root{{{dark}}}}}"


def dark_variant(color: str) -> str:
    """The colour for dark paper: greys change places, hues grow lighter until they stand out.

    >>> dark_variant("#ffffff") == DARK_PAPER
    True
    """
    rgb = to_rgb(color)
    if rgb_to_hsv(rgb)[1] < 0.2:
        grey = sum(rgb) / 3
        paper, ink = to_rgb(DARK_PAPER), 0.93
        return to_hex([ink + (p - ink) * grey for p in paper])  # type: ignore[arg-type]
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


def _variable(match: re.Match[str]) -> str:
    return match[0] if match[0] in FIXED else f"var(--c{match[0][1:]})"
