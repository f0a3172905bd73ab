"""A figure as SVG and PNG, the same bytes whenever it is drawn again."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

PNG_DPI = 200
_PATH, _LONG = re.compile(r'\bd="[^"]*"'), re.compile(r"-?\d+\.\d{3,}")


def to_svg(figure: Figure) -> str:
    """The figure as SVG without date, with ids that depend on nothing but the drawing."""
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
            FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": "trl_explore"})
    finally:
        figure.set_dpi(old)
    return buffer.getvalue()


@contextmanager
def _any_glyph() -> Iterator[None]:
    """Draw a box, without a word, for a character of a name that the font does not have."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        yield


def _rounded(path: re.Match[str]) -> str:
    """The same path in hundredths of a point, which nobody sees and halves the file."""
    return _LONG.sub(lambda number: f"{float(number[0]):.2f}".rstrip("0").rstrip("."), path[0])
