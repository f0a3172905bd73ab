"""The films of agents: the episodes are the program's own, and the pictures say what happened."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image, ImageColor

from trl_explore.commands import watch
from trl_explore.config.composing import RecordedJob, recompose_all
from trl_explore.show.film import HOLD, MARK, FilmPanel, compose, pictures
from trl_explore.show.playing import play

SMALL = ["trials=3", "first_trial=4", "max_iterations=8", "score_window=2", "keep_weights=[0,3]",
         "evaluate_every=5", "score_threshold=1000"]  # fmt: skip


@pytest.fixture(scope="module")
def place(tmp_path_factory, run_many) -> Path:
    out = tmp_path_factory.mktemp("watched")
    commands = [
        ["-m", "strategy=decaying_epsilon_greedy,vdbe", *SMALL, f"output_dir={out}"],
        ["env=catch", *SMALL, f"output_dir={out / 'other'}"],
    ]
    for ran in run_many(commands, out):
        assert ran.returncode == 0, ran.stderr
    return out


@pytest.fixture(scope="module")
def jobs(place) -> list[RecordedJob]:
    """ε-greedy with an ε that decays, whose weights suffice; and one that learns from data."""
    return recompose_all([place / "train"])


@pytest.mark.parametrize("iteration", [0, 3, 5])
def test_an_episode_is_the_next_one_of_the_training(jobs, iteration):
    """With weights that were kept, and with those of the trial trained again."""
    for job in jobs:
        rows = pd.read_csv(job.folder / "episodes.csv").set_index(["trial", "iteration"])
        episode = play(job, 5, iteration)
        assert episode.score == rows.loc[(5, iteration + 1), "score"]
        assert (episode.trial, episode.iteration, episode.stopped) == (5, iteration, False)


@pytest.mark.parametrize(("iteration", "purpose"), [(5, "scheduled"), (None, "final")])
def test_without_the_strategy_it_is_an_episode_of_an_evaluation(jobs, iteration, purpose):
    for job in jobs:
        rows = pd.read_csv(job.folder / "evaluations.csv")
        mine = rows[(rows.trial == 6) & (rows.purpose == purpose)].set_index("iteration").score
        episode = play(job, 6, iteration, greedy=True)
        assert episode.score == mine.loc[[iteration or 8]].iloc[0]
        assert episode.exploratory is not None
        assert not episode.exploratory.any()


def test_a_picture_shows_score_marks_and_end(jobs):
    panels = [
        FilmPanel(name, "when", play(job, 4, 3)) for name, job in zip("ab", jobs, strict=True)
    ]
    shown = [pictures(panel.episode) for panel in panels]
    ends = [len(panel.episode.action) for panel in panels]
    assert [len(own) for own in shown] == [n + 1 for n in ends]
    (first, n), k = min((n, k) for k, n in enumerate(ends)), max(ends)
    explored = panels[n].episode.exploratory
    assert explored is not None
    assert explored.any()
    mark = np.array(ImageColor.getrgb(MARK))

    def marked(step: int) -> int:
        """The pixels of the mark in the half of the panel that ends first, above the legend."""
        half = np.asarray(compose(panels, shown, step))[:-32]
        half = half[:, n * half.shape[1] // 2 :][:, : half.shape[1] // 2]
        return int((half == mark).all(-1).sum())

    frame = 2000  # pixels of a frame and a badge
    for step in range(1, first):
        assert (marked(step) > frame) == explored[step - 1]
    assert 0 < marked(k) < frame  # the line of actions stays
    assert np.array_equal(*(np.asarray(compose(panels, shown, s)) for s in (k, k + 5)))


def run(monkeypatch, *words: object) -> int:
    monkeypatch.setattr(sys, "argv", ["trl-explore watch", *map(str, words)])
    return watch.main()


def test_the_command_writes_a_film_of_all_jobs(place, tmp_path, monkeypatch, capsys):
    out = tmp_path / "film.gif"
    assert run(monkeypatch, place / "train", "--iteration", 0, 3, "--out", out) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(",")[0] for line in lines] == [
        "decaying ε-greedy: trial 4 after 0 iterations",
        "decaying ε-greedy: trial 4 after 3 iterations",
        "VDBE: trial 4 after 0 iterations",
        "VDBE: trial 4 after 3 iterations",
        str(out),
    ]
    with Image.open(out) as film:
        assert film.n_frames == 1 + max(
            int(line.split("steps")[0].split()[-1]) for line in lines[:-1]
        )
        assert film.width < 660  # two columns, two rows
        assert film.height > 600
        film.seek(film.n_frames - 1)
        assert film.info["duration"] == 1000 * HOLD


def test_the_same_as_a_video(place, tmp_path, monkeypatch):
    out = tmp_path / "film.mp4"
    job = next((place / "train").glob("vdbe*"))
    assert run(monkeypatch, job, "--greedy", "--out", out) == 0
    assert out.read_bytes()[4:8] == b"ftyp"


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("{}/other", "'trl_explore/Catch-v0' has no renderer of pictures (rgb_array)"),
        ("{}/train --trial 3", "--trial must be from 4 to 6, got 3"),
        ("{}/train --iteration -1", "--iteration must be >= 0, got -1"),
        ("{}/train --iteration 0 1 2 3 4 5 6", "a film shows at most 12 episodes, got 14"),
        ("{}/train --out film.png", "--out must end in .gif or .mp4, got film.png"),
        ("{}/nothing", "no finished job found"),
    ],
)
def test_wrong_words_are_one_line(words, line, place, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, *words.format(place).split()) == 1
    said = capsys.readouterr().err
    assert line in said
    assert said.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_missing_package_is_one_line(place, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "trl_explore.show.film", None)
    for module in ("PIL", "trl_explore.show.film"):
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.delitem(sys.modules, "trl_explore.show.film")
    assert run(monkeypatch, place / "train") == 1
    assert capsys.readouterr().err == (
        "error: pillow is not installed: pip install 'trl_explore[watch]'\n"
    )
