"""Any damage to the files of a job: what is read is right, or one line says what is wrong."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from trl_explore import jobs as results
from trl_explore.jobs.files import ResultsError
from trl_explore.jobs.status import status_lines, survey
from trl_explore.report.loading import load
from trl_explore.report.writing import build_report

EXAMPLES = int(os.environ.get("TRL_EXPLORE_FUZZ", "120"))
FILES = ["trials.csv", "episodes.csv", "run.json", "weights.safetensors", "scalars/score.csv"]
CELLS = ["", "nan", "inf", "-1", "0", "1e400", "9" * 30, "1_0", "x", "True", "1.5", '"', "ü", "\0",
         "converged", "capped", " 1", "0x1", "NA"]  # fmt: skip
VALUES = [None, True, -1, 0, 1.5, float("nan"), float("inf"), 10**30, "", "x", "../x", [], {}, [[]]]


def cut(data: bytes, draw) -> bytes:
    return data[: draw(st.integers(0, max(len(data) - 1, 0)))]


def flip(data: bytes, draw) -> bytes:
    changed = bytearray(data)
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.integers(0, len(data) - 1))
        changed[place] ^= draw(st.integers(1, 255))
    return bytes(changed)


def insert(data: bytes, draw) -> bytes:
    place = draw(st.integers(0, len(data)))
    return data[:place] + draw(st.binary(min_size=1, max_size=8)) + data[place:]


def cells(data: bytes, draw) -> bytes:
    """Change, remove, double or exchange cells, columns and rows of a table."""
    rows = [line.split(",") for line in data.decode().splitlines()]
    row, other = (draw(st.integers(0, len(rows) - 1)) for _ in range(2))
    column = draw(st.integers(0, len(rows[0]) - 1))
    match draw(st.sampled_from(["cell", "copy", "drop", "double", "column", "wider", "swap"])):
        case "cell":
            rows[row][column] = draw(st.sampled_from(CELLS))
        case "copy":
            rows[row] = rows[other]
        case "drop":
            del rows[row]
        case "double":
            rows.insert(row, rows[row])
        case "column":
            rows = [r[:column] + r[column + 1 :] for r in rows]
        case "wider":
            rows = [[*r, "1"] if k else r for k, r in enumerate(rows)]
        case "swap":
            rows[row], rows[other] = rows[other], rows[row]
    return ("\n".join(",".join(r) for r in rows) + "\n").encode()


def entries(data: bytes, draw) -> bytes:
    """Change or remove an entry of a record."""
    record = json.loads(data)
    place = record
    if draw(st.booleans()):
        place = record["config"]
    key = draw(st.sampled_from(sorted(place)))
    if draw(st.booleans()):
        del place[key]
    else:
        place[key] = draw(st.sampled_from(VALUES))
    return json.dumps(record).encode()


@pytest.fixture(scope="module")
def job(tmp_path_factory, train):
    """A real job of three trials."""
    from trl_explore.strategies import Softmax

    trainer = train(Softmax(), trials=3, max_iterations=6, score_window=3, score_threshold=28)
    folder = tmp_path_factory.mktemp("fuzz") / "train" / "softmax"
    folder.mkdir(parents=True)
    config = {
        "seed": 0, "trials": 3, "first_trial": 0, "threads": 1, "max_iterations": 6,
        "score_threshold": 28.0, "score_window": 3,
        "strategy": {"_target_": "x", "temperature": 1.0}, "env": {"id": "CartPole-v1"},
    }  # fmt: skip
    results.write_job(
        folder,
        trainer.trials,
        dict(trainer.collector.policy[0].named_parameters()),
        config=config,
        experiment="train",
        strategy="softmax",
        collector="TorchRLCollector",
        seconds=1.0,
    )
    run = results.read_run(folder)  # without digests, which would notice any change
    (folder / "run.json").write_text(json.dumps({**run, "files": {}}))
    return folder


def read(folder: Path, reader):
    """What a reader returns, or None if it refuses with one line."""
    try:
        return reader(folder)
    except ResultsError as error:
        line = str(error)
    assert len(line.splitlines()) == 1
    assert folder.name in line
    return None


def check(folder: Path, whole: Path) -> None:
    """What is read of a damaged job is sound, and nothing but ResultsError is raised."""
    outcomes, expected = read(folder, results.read_job), results.read_job(whole)
    if outcomes is not None:
        assert len(outcomes) == 3
        assert np.isfinite(outcomes.score).all()
        assert ((outcomes.iterations >= 1) & (outcomes.frames >= 1)).all()
        assert ((outcomes.status == "converged") == outcomes.converged).all()
        assert outcomes.trial.tolist() == list(range(outcomes.trial[0], outcomes.trial[0] + 3))
    episodes = read(folder, results.read_episodes)
    if episodes is not None and outcomes is not None:
        assert episodes["frames"].sum() == outcomes.frames.sum()
        assert len(episodes) == outcomes.iterations.sum()
        assert np.isfinite(episodes["score"]).all()
    weights = read(folder, results.read_weights)
    if weights is not None and (folder / FILES[3]).read_bytes() == (whole / FILES[3]).read_bytes():
        assert {name: w.shape for name, w in weights.items()} == {
            name: w.shape for name, w in results.read_weights(whole).items()
        }
    read(folder, results.read_curves)
    assert status_lines(survey([folder])[0])
    loaded = read(folder, lambda path: load([path]))
    assert loaded is None or len(loaded.jobs) == 1
    assert len(expected) == 3


@settings(
    max_examples=EXAMPLES,
    deadline=None,
    derandomize=EXAMPLES < 200,
    suppress_health_check=list(HealthCheck),
)
@given(st.data())
def test_damage_of_any_kind(job, tmp_path_factory, data):
    folder = tmp_path_factory.getbasetemp() / "damaged" / "softmax"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(job, folder)
    name = data.draw(st.sampled_from(FILES))
    kinds = [cut, flip, insert]
    kinds += {".csv": [cells] * 3, ".json": [entries] * 3}.get(Path(name).suffix, [])
    kind = data.draw(st.sampled_from(kinds))
    changed = kind((folder / name).read_bytes(), data.draw)
    (folder / name).write_bytes(changed)
    check(folder, job)


@settings(
    max_examples=max(EXAMPLES // 12, 5),
    deadline=None,
    derandomize=EXAMPLES < 200,
    suppress_health_check=list(HealthCheck),
)
@given(st.data())
def test_a_report_on_damaged_records(job, tmp_path_factory, data):
    """What passes the readers passes the report: whatever the record says, there is a page."""
    place = tmp_path_factory.getbasetemp() / "reported"
    shutil.rmtree(place, ignore_errors=True)
    folder = place / "train" / "softmax"
    shutil.copytree(job, folder)
    for _ in range(data.draw(st.integers(1, 3))):
        (folder / "run.json").write_bytes(entries((folder / "run.json").read_bytes(), data.draw))
        if not isinstance(json.loads((folder / "run.json").read_text()).get("config"), dict):
            break
        if not json.loads((folder / "run.json").read_text())["config"]:
            break
    made = read(folder, lambda _: build_report([place], place / "out"))
    assert made is None or made[0].is_file()
