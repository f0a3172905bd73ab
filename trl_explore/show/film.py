"""A film of episodes side by side, as a GIF or an MP4."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from math import ceil
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from matplotlib.font_manager import findfont
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from trl_explore.checks import first_line
from trl_explore.show.playing import Episode, replayed

WIDTH, GAP = 300, 14
"""Width of a panel and of the space around it [px]."""
ROW = 4
"""Most panels in a row."""
PICTURES = 150
"""Most pictures of a film, so that its file stays small; of longer episodes every k-th is shown."""
HOLD = 2.0
"""Seconds for which the last picture stays."""
COLOURS = 64
"""Colours of a GIF."""
INK, GREY, PALE, MARK = "#1f2937", "#6b7280", "#e5e7eb", "#d55e00"
LEGEND = "exploratory: not the action that the policy prefers"


@dataclass(frozen=True, eq=False)
class FilmPanel:
    """An episode with its heading: the name of what acts, and a line on when."""

    title: str
    when: str
    episode: Episode


def pictures(episode: Episode) -> list[NDArray[np.uint8]]:
    """What the environment's renderer shows before every action and after the last.

    Raises:
        ValueError: if the environment has no renderer, or the renderer lacks a package.
    """
    os.environ.setdefault("SDL_VIDEODRIVER", "dummy")  # no window
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    lanes = episode.lanes
    modes = lanes.metadata.get("render_modes") or []
    if "rgb_array" not in modes:
        raise ValueError(f"environment {lanes.id!r} has no renderer of pictures (rgb_array)")
    try:
        return replayed(
            episode,
            lambda env, _: np.asarray(env.render(), dtype=np.uint8),
            render_mode="rgb_array",
        )
    except gym.error.DependencyNotInstalled as error:
        raise ValueError(
            f"the renderer of {lanes.id!r} needs a missing package: "
            f"pip install 'trl_explore[watch]' ({first_line(error)})"
        ) from error


def write_film(path: Path, panels: Sequence[FilmPanel], columns: int = ROW) -> None:
    """Draw the episodes side by side, and write the film.

    Args:
        path: a file that ends in ``.gif`` or ``.mp4``.
        panels: the episodes; the film goes on until the longest has ended.
        columns: most panels in a row.

    Raises:
        ValueError: if an environment cannot be shown.
        OSError: if the file cannot be written.
    """
    shown = [pictures(panel.episode) for panel in panels]
    longest = max(map(len, shown))
    stride = ceil(longest / PICTURES)
    rate = float(panels[0].episode.lanes.metadata.get("render_fps") or 30) / stride
    steps = [*range(0, longest - 1, stride), longest - 1]
    frames = (compose(panels, shown, step, stride, columns) for step in steps)
    if path.suffix == ".gif":
        _write_gif(path, list(frames), max(20, round(1000 / rate)))
    else:
        _write_mp4(path, frames, rate)


def compose(
    panels: Sequence[FilmPanel],
    shown: Sequence[Sequence[NDArray[np.uint8]]],
    step: int,
    stride: int = 1,
    columns: int = ROW,
) -> Image.Image:
    """The picture of the film after ``step`` actions.

    Args:
        panels: the episodes.
        shown: the pictures of each.
        step: the number of actions so far; an episode that has ended before is shown as ended.
        stride: an exploratory action is marked if it is among so many last actions.
        columns: most panels in a row.
    """
    tall = max(_fitted(p[0].shape) for p in shown)
    height, columns = tall + 96, min(columns, len(panels))
    rows = ceil(len(panels) / columns)
    marks = any(panel.episode.exploratory is not None for panel in panels)
    size = (columns * (WIDTH + GAP) + GAP, rows * (height + GAP) + (32 if marks else GAP))
    film = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(film)
    longest = max(len(panel.episode.action) for panel in panels)
    for k, (panel, own) in enumerate(zip(panels, shown, strict=True)):
        x, y = GAP + k % columns * (WIDTH + GAP), GAP + k // columns * (height + GAP)
        _draw_panel(film, draw, (x, y), panel, own, step, stride, tall, longest)
    if marks:
        y = size[1] - 26
        draw.rectangle((GAP, y + 3, GAP + 11, y + 14), fill=MARK)
        draw.text((GAP + 18, y), LEGEND, GREY, font(13))
    return film


def _draw_panel(
    film: Image.Image,
    draw: ImageDraw.ImageDraw,
    corner: tuple[int, int],
    panel: FilmPanel,
    shown: Sequence[NDArray[np.uint8]],
    step: int,
    stride: int,
    tall: int,
    longest: int,
) -> None:
    """Heading, picture, score and the line of actions."""
    (x, y), episode = corner, panel.episode
    n = len(episode.action)
    now = min(step, n)
    draw.text((x, y), _fit(panel.title, font(17, bold=True)), INK, font(17, bold=True))
    draw.text((x, y + 22), _fit(panel.when, font(13)), GREY, font(13))
    y += 44
    picture = Image.fromarray(shown[min(now, len(shown) - 1)])
    picture = picture.resize((WIDTH, _fitted(shown[0].shape)), Image.Resampling.LANCZOS)
    if now == n:
        picture = Image.blend(picture, Image.new("RGB", picture.size, "white"), 0.6)
    film.paste(picture, (x, y))
    explored = episode.exploratory
    marked = explored is not None and bool(explored[max(0, now - stride) : now].any())
    marked = marked and step < n
    edge = (x, y, x + WIDTH - 1, y + picture.height - 1)
    draw.rectangle(edge, outline=MARK if marked else PALE, width=3 if marked else 1)
    if now == n:
        ended = "ended" if episode.terminated else "time is up"
        text = f"{ended} after {n} step{'s' if n > 1 else ''}"
        at = (x + WIDTH // 2, y + 28)
        draw.text(at, text, INK, font(17, bold=True), anchor="mm")
    y += tall + 8
    draw.text((x, y), f"score {round(episode.reward[:now].sum(), 1):g}", INK, font(17, bold=True))
    if marked:
        draw.rounded_rectangle((x + WIDTH - 98, y - 1, x + WIDTH - 1, y + 21), 6, fill=MARK)
        draw.text((x + WIDTH - 50, y + 10), "exploratory", "white", font(13), anchor="mm")
    _draw_line(draw, (x, y + 30), episode, now, longest)


def _draw_line(
    draw: ImageDraw.ImageDraw, corner: tuple[int, int], episode: Episode, now: int, longest: int
) -> None:
    """The actions so far as a line, as long as the longest episode; exploratory ones in colour."""
    x, y = corner
    scale = WIDTH / longest
    draw.rectangle((x, y + 3, x + WIDTH - 1, y + 5), fill=PALE)
    draw.rectangle((x, y + 3, x + max(1, round(now * scale)) - 1, y + 5), fill=GREY)
    explored = episode.exploratory
    for t in np.flatnonzero(explored[:now]) if explored is not None else ():
        left = x + int(t * scale)
        draw.rectangle((left, y, max(left, x + int((t + 1) * scale) - 1), y + 8), fill=MARK)


def _fitted(shape: tuple[int, ...]) -> int:
    """The height of a picture that is as wide as a panel."""
    return round(shape[0] * WIDTH / shape[1])


def _fit(text: str, font: ImageFont.FreeTypeFont) -> str:
    """The text, cut to the width of a panel."""
    if font.getlength(text) <= WIDTH:
        return text
    while text and font.getlength(f"{text}…") > WIDTH:
        text = text[:-1]
    return f"{text}…"


@cache
def font(size: int, *, bold: bool = False) -> ImageFont.FreeTypeFont:
    """A font with the letters ε and π: the one that matplotlib brings."""
    return ImageFont.truetype(findfont("DejaVu Sans:bold" if bold else "DejaVu Sans"), size)


def _write_gif(path: Path, frames: Sequence[Image.Image], duration: int) -> None:
    """Write with one palette for all pictures, so that only what moves is stored."""
    some = frames[:: max(1, len(frames) // 8)]
    sheet = Image.new("RGB", (frames[0].width, frames[0].height * len(some)))
    for k, frame in enumerate(some):
        sheet.paste(frame, (0, k * frame.height))
    palette = sheet.quantize(COLOURS, method=Image.Quantize.MEDIANCUT)
    first, *others = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    durations = [duration] * len(others) + [int(1000 * HOLD)]
    first.save(path, save_all=True, append_images=others, duration=durations, loop=0, optimize=True)


def _write_mp4(path: Path, frames: Iterator[Image.Image], rate: float) -> None:
    import imageio

    opened: Any = imageio.get_writer(path, fps=rate, macro_block_size=2)
    with opened as writer:
        picture: Any = None
        for frame in frames:
            even = (0, 0, frame.width // 2 * 2, frame.height // 2 * 2)
            picture = np.asarray(frame.crop(even))
            writer.append_data(picture)
        for _ in range(round(HOLD * rate)):
            writer.append_data(picture)
