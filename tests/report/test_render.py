import io
import re
import zlib

import numpy as np
from fontTools.ttLib import TTFont
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from trl_explore.report.image_files import to_pdf, to_png, to_svg
from trl_explore.report.style import visual_language


def figure(text: str = "a") -> Figure:
    with visual_language():
        made = Figure(figsize=(2, 2), layout="constrained")
        ax = made.subplots()
        ax.plot([1, 2, 3], marker="o", clip_on=True)
        ax.set_title(text)
    return made


def test_every_format_has_the_same_bytes_each_time():
    for write in (to_svg, to_png, to_pdf):
        assert write(figure()) == write(figure())
    assert to_pdf(figure()).startswith(b"%PDF")


def test_svg_has_no_date_and_no_version():
    svg = to_svg(figure())
    assert "<dc:date>" not in svg
    assert "matplotlib.org" not in svg


def test_png_has_no_version_and_is_fine_enough_for_print():
    png = to_png(figure())
    assert b"Matplotlib" not in png
    assert int.from_bytes(png[16:20], "big") == 400


def test_png_has_the_pixels_of_the_drawing():
    drawn = figure()
    drawn.set_dpi(200)
    canvas = FigureCanvasAgg(drawn)
    canvas.draw()
    expected = np.asarray(canvas.buffer_rgba())
    assert (expected[..., 3] == 255).all()
    found = np.asarray(Image.open(io.BytesIO(to_png(figure()))))
    assert (found == expected[..., :3]).all()


def test_pdf_embeds_the_outlines_of_its_letters():
    pdf = to_pdf(figure("ab ≥"))
    fonts = [
        TTFont(io.BytesIO(data))
        for stream in re.findall(rb"stream\r?\n(.*?)endstream", pdf, flags=re.S)
        if (data := zlib.decompressobj().decompress(stream)).startswith(b"\0\1\0\0")
    ]
    letters = "ab≥1230."
    drawn = sum(
        font["glyf"][name].numberOfContours > 0
        for font in fonts
        for name in font["glyf"].glyphOrder
    )
    assert drawn >= len(letters)
    assert all({"cvt ", "fpgm", "prep", "hmtx"} <= set(font.keys()) for font in fonts)


def test_names_are_drawn_as_they_are_written():
    # No mathematics, and no warning for a character that the font lacks.
    for text in ("$\\frac{$", "a_b^c", "<script>", "\u4e2d\u6587"):
        assert to_svg(figure(text))
        assert to_png(figure(text))
