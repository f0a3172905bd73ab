"""The files of a checkpoint: what they hold, and what becomes of them when something goes wrong."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from trl_explore.jobs import checkpoint
from trl_explore.jobs.checkpoint import HISTORY, SLOTS, DamagedError, Store, pack, unpack

WEIGHT = torch.arange(6.0).reshape(2, 3)
STATE = {
    "none": None,
    "flag": True,
    "count": 2**60,
    "rate": 0.1,
    "name": 'ε, "quoted"\n',
    "tuple": (1, [2, (3.5,)], {}),
    "not finite": [float("inf"), float("-inf")],
    3: {"nested": np.float64(0.25), 4: np.array(7)},
    "weight": WEIGHT,
    "again": WEIGHT,
    "transposed": WEIGHT.t(),
    "bool": np.array([True, False]),
    "none of them": torch.zeros(0, 4),
    "number": torch.tensor(5),
    "bytes": torch.arange(256, dtype=torch.uint8),
    "nan": np.array([np.nan, -0.0]),
}


def same(one, two) -> bool:
    """Equal in type and value, bit for bit."""
    if type(one) is not type(two):
        return False
    if isinstance(one, dict):
        return list(one) == list(two) and all(same(one[key], two[key]) for key in one)
    if isinstance(one, list | tuple):
        return len(one) == len(two) and all(map(same, one, two))
    if isinstance(one, torch.Tensor):
        return same(one.numpy(), two.numpy())
    if isinstance(one, np.ndarray | np.generic):
        alike = (one.dtype, one.shape) == (two.dtype, two.shape)
        return alike and np.ascontiguousarray(one).tobytes() == two.tobytes()
    return one == two


def test_a_state_comes_back_as_it_was():
    data = checkpoint.to_bytes({"iteration": 3}, pack(STATE))
    header, packed = checkpoint.from_bytes(data)
    assert header == {"iteration": 3}
    assert same(unpack(packed), STATE)


def test_what_is_the_same_memory_is_stored_once():
    packed = pack(STATE)
    assert "again" not in packed.arrays
    assert {"weight", "transposed"} <= set(packed.arrays)
    layer = nn.Linear(100, 100)
    twice = {"policy": layer.state_dict(), "loss": layer.state_dict()}
    assert len(checkpoint.to_bytes({}, pack(twice))) < 1.1 * 4 * (100 * 100 + 100)


def test_entries_whose_paths_read_the_same_stay_apart():
    state = {
        "layer.0": np.ones(2), "layer": [np.zeros(2), np.ones(3)], 1: torch.ones(1),
        "1": torch.zeros(1), "layer.0'": np.full(2, 7.0),
    }  # fmt: skip
    assert same(unpack(pack(state)), state)


def test_copies_from_another_device_are_not_taken_for_one_another(monkeypatch):
    """A copy is gone when the next one is made, which may well get its memory."""
    memory = torch.zeros(2)
    monkeypatch.setattr(torch.Tensor, "cpu", lambda tensor: memory.copy_(tensor))
    state = {"first": torch.tensor([1.0, 2.0]), "second": torch.tensor([3.0, 4.0])}
    found = unpack(pack(state))
    assert (found["first"].tolist(), found["second"].tolist()) == ([1, 2], [3, 4])


def test_a_packed_state_is_a_copy():
    weight, table = torch.zeros(2), np.zeros(2)
    packed = pack({"weight": weight, "table": table})
    weight += 1
    table += 1
    assert unpack(packed)["weight"].tolist() == [0, 0]
    assert unpack(packed)["table"].tolist() == [0, 0]


@pytest.mark.parametrize(
    ("state", "message"),
    [
        ({"loss": {"seen": {1, 2}}}, r"loss\.seen.*set"),
        ({"loss": [0, object()]}, r"loss\.1.*object"),
        ({"loss": {(1, 2): 0}}, "loss.*key"),
    ],
)
def test_other_states_are_refused(state, message):
    with pytest.raises(TypeError, match=message):
        pack(state)


def test_every_flipped_bit_is_noticed():
    data = checkpoint.to_bytes({"seed": 1}, pack({"w": np.arange(3), "lr": 0.5}))
    unnoticed = []
    for place in range(len(data)):
        for bit in range(8):
            changed = bytearray(data)
            changed[place] ^= 1 << bit
            try:
                checkpoint.from_bytes(bytes(changed))
            except DamagedError:
                continue
            unnoticed.append((place, bit))
    assert unnoticed == []


def test_every_truncation_is_noticed():
    data = checkpoint.to_bytes({"seed": 1}, pack({"w": np.arange(3), "lr": 0.5}))
    for size in range(len(data)):
        with pytest.raises(DamagedError):
            checkpoint.from_bytes(data[:size])
    with pytest.raises(DamagedError):
        checkpoint.from_bytes(data + b"\0")


def part(k: int) -> dict[str, np.ndarray]:
    """The history of iteration k."""
    return {"score": np.full(50, float(k))}


def fill(store: Store, first: int, last: int) -> None:
    """Checkpoints after the iterations from ``first`` to ``last``."""
    for k in range(first, last + 1):
        store.save(
            {"iteration": k}, pack({"iteration": k, "w": torch.full((4,), float(k))}), part(k)
        )


def found(folder: Path) -> int:
    """The iteration that a job goes on from, 0 for the beginning; state and history agree."""
    loaded, _ = Store(folder).load()
    if loaded is None:
        return 0
    k = loaded.header["iteration"]
    state = unpack(loaded.state)
    assert state["iteration"] == k
    assert state["w"].tolist() == [k] * 4
    assert [columns["score"].tolist() for columns in loaded.history] == [
        [float(j)] * 50 for j in range(1, k + 1)
    ]
    return k


def test_the_newest_is_found(tmp_path):
    store = Store(tmp_path)
    assert found(tmp_path) == 0
    for k in range(1, 6):
        fill(store, k, k)
        assert found(tmp_path) == k
    other = Store(tmp_path)
    other.load()
    fill(other, 6, 8)
    assert found(tmp_path) == 8
    assert sorted(path.name for path in (tmp_path / "checkpoint" / "0").iterdir()) == [
        *SLOTS, "history.bin",
    ]  # fmt: skip
    other.clear()
    assert found(tmp_path) == 0
    assert list(tmp_path.rglob("*")) == [tmp_path / "checkpoint"]


def test_a_checkpoint_does_not_grow_with_the_run(tmp_path):
    store, sizes = Store(tmp_path), []
    for k in range(1, 40):
        fill(store, k, k)
        sizes.append((tmp_path / "checkpoint" / "0" / SLOTS[k % 2]).stat().st_size)
    assert max(sizes) - min(sizes) <= 16  # the digits of the numbers in it


def newest(folder: Path) -> Path:
    return max(
        (folder / "checkpoint" / "0" / name for name in SLOTS), key=lambda p: p.stat().st_mtime_ns
    )


def test_the_one_before_is_found_where_the_newest_is_damaged(tmp_path):
    store = Store(tmp_path)
    fill(store, 1, 5)
    path = newest(tmp_path)
    path.write_bytes(path.read_bytes()[:-7])
    assert found(tmp_path) == 4
    after = Store(tmp_path)
    _, damaged = after.load()
    (line,) = damaged
    assert str(path) in line
    fill(after, 5, 5)  # takes the place of the damaged one, and the history goes on from 4
    assert found(tmp_path) == 5
    assert Store(tmp_path).load()[1] == []


def test_a_damaged_history_counts_as_far_as_it_is_whole(tmp_path):
    store = Store(tmp_path)
    fill(store, 1, 4)
    path = tmp_path / "checkpoint" / "0" / "history.bin"
    whole = path.read_bytes()
    path.write_bytes(whole[:-1])
    assert found(tmp_path) == 3
    middle = bytearray(whole)
    middle[len(whole) // 4] ^= 1
    path.write_bytes(bytes(middle))
    assert found(tmp_path) == 0
    path.unlink()
    assert found(tmp_path) == 0
    path.write_bytes(whole + b"what a kill left")
    assert found(tmp_path) == 4


def test_a_history_of_another_run_is_noticed(tmp_path):
    """A checkpoint with the history of a run that was longer, or other, at the same length."""
    for name, score in (("one", 1.0), ("two", 2.0)):
        (tmp_path / name).mkdir()
        Store(tmp_path / name).save({}, pack({}), {"score": np.full(50, score)})
    one, two = (tmp_path / name / "checkpoint" / "0" / "history.bin" for name in ("one", "two"))
    one.write_bytes(two.read_bytes())
    loaded, damaged = Store(tmp_path / "one").load()
    assert loaded is None
    assert len(damaged) == 1


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EACCES])
@pytest.mark.parametrize("nth", range(6))
def test_a_fault_at_any_step_loses_nothing(tmp_path, monkeypatch, nth, code):
    store = Store(tmp_path)
    fill(store, 1, 3)
    calls, failed = [0], []

    def fail_at(function):
        def wrapped(*args, **kwargs):
            calls[0] += 1
            if calls[0] > nth:
                raise OSError(code, os.strerror(code))
            return function(*args, **kwargs)

        return wrapped

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", fail_at(os.fsync))
        patch.setattr(Path, "replace", fail_at(Path.replace))
        patch.setattr(Path, "open", fail_at(Path.open))
        try:
            fill(store, 4, 4)
        except OSError as error:
            failed.append(error)
    steps = 5  # open and sync of the history; open, sync and rename of the checkpoint
    assert bool(failed) == (nth < steps)
    assert found(tmp_path) == (3 if failed else 4)
    assert not list(tmp_path.rglob("*.tmp"))
    fill(store, 4 if failed else 5, 6)
    assert found(tmp_path) == 6


def test_a_full_disk(tmp_path):
    """The kernel's own ENOSPC, after the bytes have been accepted into a buffer."""
    store = Store(tmp_path)
    fill(store, 1, 2)
    (tmp_path / "checkpoint" / "0" / f".{SLOTS[1]}.tmp").symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left on device"):
        fill(store, 3, 3)
    assert found(tmp_path) == 2
    fill(store, 3, 4)
    assert found(tmp_path) == 4


def test_what_a_failed_attempt_has_left_is_cut_off(tmp_path):
    store = Store(tmp_path)
    fill(store, 1, 3)
    path = store.folder / HISTORY
    with path.open("ab") as file:
        file.write(b"x" * 10_000)
    fill(store, 4, 4)
    checkpoint, _ = Store(tmp_path).load()
    assert checkpoint is not None
    assert path.stat().st_size == checkpoint.header["store"]["length"]


def test_a_history_that_has_gone_is_known_to_be_lost(tmp_path):
    store = Store(tmp_path)
    assert not store.lost()
    fill(store, 1, 3)
    assert not store.lost()
    (store.folder / HISTORY).unlink()
    assert store.lost()


def test_a_removal_that_was_broken_off_leaves_no_checkpoint(tmp_path, monkeypatch):
    def killed(folder):
        raise OSError("killed")

    fill(Store(tmp_path), 1, 3)
    monkeypatch.setattr(shutil, "rmtree", killed)
    with pytest.raises(OSError, match="killed"):
        Store(tmp_path).clear()
    assert Store(tmp_path).load() == (None, [])


def test_a_slot_that_cannot_be_opened_is_like_a_damaged_one(tmp_path):
    fill(Store(tmp_path), 1, 3)
    path = newest(tmp_path)
    path.unlink()
    path.mkdir()
    store = Store(tmp_path)
    checkpoint, damaged = store.load()
    assert checkpoint is not None
    assert len(damaged) == 1
    store.clear()
    assert not store.folder.exists()
