"""A figure as reproducible SVG, PNG and PDF, and SVG inside a page."""

from __future__ import annotations

import gc
import io
import re
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from html import escape
from typing import Any

import matplotlib as mpl
import numpy as np
from fontTools import subset
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from PIL import Image

from trl_explore.report.style import MAP, MAP_INKS, dark_variant

PNG_DPI = 200
FONT_TABLES = {"head", "hhea", "maxp", "hmtx", "loca", "glyf", "cvt ", "fpgm", "prep"}
"""The tables of a TrueType font that a PDF needs (ISO 32000-1, 9.9); cairo embeds the same."""
FIXED = frozenset((*MAP, *MAP_INKS))
"""Colours of a map, which are the same in both themes: the text colour fits its cell."""
_COLOR = re.compile(r"#[0-9a-f]{6}\b")
_PATH, _DECIMALS = re.compile(r'\bd="[^"]*"'), re.compile(r"-?\d+\.\d{3,}")


def to_svg(figure: Figure) -> str:
    """The figure as SVG, without a date and with ids that depend only on the drawing."""
    buffer = io.BytesIO()
    settings = {"svg.hashsalt": "trl_explore", "svg.fonttype": "path", "text.parse_math": False}
    with mpl.rc_context(settings), _any_glyph():  # type: ignore[arg-type]
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None, "Creator": "trl_explore"})
    return _PATH.sub(_rounded, buffer.getvalue().decode("utf-8"))


def to_png(figure: Figure) -> bytes:
    """The figure as PNG at 200 dots per inch, without a version in its metadata."""
    buffer = io.BytesIO()
    old = figure.dpi
    figure.set_dpi(PNG_DPI)
    try:
        with mpl.rc_context({"text.parse_math": False}), _any_glyph():
            canvas = FigureCanvasAgg(figure)
            canvas.draw()
    finally:
        figure.set_dpi(old)
    # The paper is opaque: without a fourth channel, the fast level 3 gives as small a file.
    pixels = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
    pixels.save(buffer, "png", dpi=(PNG_DPI, PNG_DPI), compress_level=3)
    return buffer.getvalue()


def to_pdf(figure: Figure) -> bytes:
    """The figure as PDF with embedded TrueType fonts, without dates."""
    buffer = io.BytesIO()
    settings = {"pdf.fonttype": 42, "text.parse_math": False}
    with mpl.rc_context(settings), _any_glyph(), _small_fonts():  # type: ignore[arg-type]
        metadata = {"CreationDate": None, "Creator": "trl_explore", "Producer": None}
        FigureCanvasPdf(figure).print_pdf(buffer, metadata=metadata)
    return buffer.getvalue()


def drawn_files(figure: Figure) -> dict[str, Any]:
    """The figure in every format: ``svg``, ``png`` and ``pdf``."""
    collects = gc.isenabled()
    gc.disable()  # garbage is freed after the figure; collecting during it takes a fifth longer
    try:
        svg = to_svg(figure)
        figure.set_layout_engine("none")  # the layout is the same in every format
        return {"svg": svg, "png": to_png(figure), "pdf": to_pdf(figure)}
    finally:
        if collects:
            gc.enable()


def inline_svg(svg: str, name: str, alt: str) -> str:
    """The drawing as an element of the page, with alternative text.

    Args:
        svg: from :func:`to_svg`.
        name: prefix of every id, unique within the page.
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
    """CSS variables of all colours in the drawings, for light and dark screens."""
    colors = sorted({c for svg in svgs for c in _COLOR.findall(svg)} - FIXED)
    light = "".join(f"--c{c[1:]}:{c};" for c in colors)
    dark = "".join(f"--c{c[1:]}:{dark_variant(c)};" for c in colors)
    return f":root{{{light}}}@media screen and (prefers-color-scheme:dark){{:root{{{dark}}}}}"


@contextmanager
def _any_glyph() -> Iterator[None]:
    """Suppress the warning about characters that the font lacks; they are drawn as boxes."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        yield


@contextmanager
def _small_fonts() -> Iterator[None]:
    """Embed only ``FONT_TABLES``: subsetting the other tables takes most of the time of a PDF."""
    load = subset.load_font

    def load_small(*args: Any, **options: Any) -> Any:
        font = load(*args, **options)
        if "glyf" in font:
            font.setGlyphOrder([f"glyph{k:05}" for k in range(font["maxp"].numGlyphs)])
            for table in set(font.keys()) - FONT_TABLES - {"GlyphOrder"}:
                del font[table]
        return font

    subset.load_font = load_small
    try:
        yield
    finally:
        subset.load_font = load


def _rounded(path: re.Match[str]) -> str:
    """The path rounded to hundredths of a point: invisible, and halves the file size."""
    return _DECIMALS.sub(lambda number: f"{float(number[0]):.2f}".rstrip("0").rstrip("."), path[0])


def _variable(match: re.Match[str]) -> str:
    return match[0] if match[0] in FIXED else f"var(--c{match[0][1:]})"
