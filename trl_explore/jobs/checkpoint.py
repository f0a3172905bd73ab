"""The checkpoint files of a job, which stay valid if the process is killed at any instant.

The folder ``checkpoint/<k>/`` of shard k of an unfinished job holds:

    a.safetensors, b.safetensors   the last two checkpoints, written alternately
    history.bin                    the episodes up to the last checkpoint, append-only

A checkpoint is one safetensors file. It holds the tensors of a nested state; its metadata holds the
rest of the state as JSON, a header, and a SHA-256 of everything. It is written to a temporary file,
synced and renamed. The history only grows, so that the cost of a checkpoint does not grow with the
run: a checkpoint states how many bytes of the history are valid, and their digest. Bytes after that
length, left by an interrupted write, are dropped. No file is read with pickle.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trl_explore.checks import first_line
from trl_explore.jobs.files import write_whole

FOLDER, SLOTS, HISTORY = "checkpoint", ("a.safetensors", "b.safetensors"), "history.bin"
START = {"number": 0, "length": 0, "seal": bytes(hashlib.sha256().digest_size).hex()}
"""Of a checkpoint: its number, and the length and digest of its history; here, before the first."""

Arrays = dict[str, NDArray[Any]]


class DamagedError(ValueError):
    """A file that is damaged; the message says how this was detected."""


class Packed(NamedTuple):
    """A copy of a state as arrays and JSON; later changes of the state do not affect it."""

    tree: str
    arrays: Arrays


def pack(state: Any) -> Packed:
    """Convert a nested state to arrays and one JSON text.

    The state consists of dicts, lists and tuples of None, bool, int, float, str, numpy arrays and
    torch tensors. A tensor that occurs twice, such as weights shared by policy and loss, is stored
    once.

    Raises:
        TypeError: if an entry has another type; the message names the entry.

    Example:
        >>> packed = pack({"lr": 0.1, "steps": (1, 2), "weight": np.ones(3)})
        >>> unpack(packed)
        {'lr': 0.1, 'steps': (1, 2), 'weight': array([1., 1., 1.])}
    """
    arrays: Arrays = {}
    seen: dict[Any, str] = {}

    def walk(node: Any, path: str) -> Any:
        plain = node is None or isinstance(node, bool | int | float | str)
        if plain and not isinstance(node, np.number):  # np.float64 is also a float
            return node
        if isinstance(node, Mapping):
            pairs = [[key, walk(value, f"{path}.{key}")] for key, value in node.items()]
            if not all(isinstance(key, str | int) for key, _ in pairs):
                raise TypeError(f"the state of {path[1:]} has a key that is not a str or int")
            return {"dict": pairs}
        if isinstance(node, list | tuple):
            values = [walk(value, f"{path}.{k}") for k, value in enumerate(node)]
            return values if isinstance(node, list) else {"tuple": values}
        kind, array, identity = _array(node, path)
        if identity in seen:
            return {kind: seen[identity]}
        name = path[1:]
        while name in arrays:  # another entry has the same path: "a.b", and "b" in "a"
            name += "'"
        seen[identity], arrays[name] = name, array.copy(order="C")
        return {kind: name}

    return Packed(json.dumps(walk(state, "")), arrays)


def _array(node: Any, path: str) -> tuple[str, NDArray[Any], Any]:
    """The kind of an array, its values, and a key that identifies its memory."""
    if isinstance(node, np.generic):
        return "number", np.asarray(node), object()
    if isinstance(node, np.ndarray):
        return "array", node, object()
    import torch

    if isinstance(node, torch.Tensor):
        # Identify the node, not its copy on the CPU: the memory of that copy is soon reused.
        identity = (node.device, node.data_ptr(), node.shape, node.stride(), node.dtype)
        return "tensor", node.detach().cpu().numpy(), identity
    raise TypeError(
        f"the state of {path[1:]} is a {type(node).__name__}; a checkpoint can hold None, bool, "
        "int, float, str, arrays and tensors, in dicts, lists and tuples"
    )


def unpack(packed: Packed) -> Any:
    """Restore the state that ``pack`` converted."""
    tensors: dict[str, Any] = {}

    def tensor(name: str) -> Any:
        import torch

        if name not in tensors:
            tensors[name] = torch.from_numpy(packed.arrays[name].copy())
        return tensors[name]

    def walk(node: Any) -> Any:
        if isinstance(node, list):
            return [walk(value) for value in node]
        if not isinstance(node, dict):
            return node
        ((kind, value),) = node.items()
        if kind == "dict":
            return {key: walk(child) for key, child in value}
        if kind == "tuple":
            return tuple(walk(child) for child in value)
        if kind == "number":
            return packed.arrays[value][()]
        return packed.arrays[value] if kind == "array" else tensor(value)

    return walk(json.loads(packed.tree))


def _digest(texts: Mapping[str, str], arrays: Arrays) -> str:
    found = hashlib.sha256(json.dumps(texts, sort_keys=True).encode())
    for name in sorted(arrays):
        array = arrays[name]
        found.update(f"{name} {array.dtype.str} {array.shape}".encode())
        found.update(array.reshape(-1).view(np.uint8).data)
    return found.hexdigest()


def to_bytes(header: Mapping[str, Any], packed: Packed) -> bytes:
    """The contents of a checkpoint file."""
    from safetensors.numpy import save

    texts = {"header": json.dumps(header), "state": packed.tree}
    return save(packed.arrays, {**texts, "sha256": _digest(texts, packed.arrays)})


def from_bytes(data: bytes) -> tuple[dict[str, Any], Packed]:
    """The header and the state in a checkpoint file.

    Raises:
        DamagedError: if the contents are not those that ``to_bytes`` returned.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load

    try:
        arrays = load(data)
        size = int.from_bytes(data[:8], "little")
        metadata = json.loads(data[8 : 8 + size])["__metadata__"]
        expected = metadata.pop("sha256")
        if _digest(metadata, arrays) != expected:
            raise DamagedError("its checksum is wrong")
        return json.loads(metadata["header"]), Packed(metadata["state"], arrays)
    except (SafetensorError, ValueError, KeyError, TypeError) as error:
        if isinstance(error, DamagedError):
            raise
        raise DamagedError(f"not readable: {first_line(error)}") from None


class Checkpoint(NamedTuple):
    """A checkpoint: the header, the state, and the episodes up to it, in parts."""

    header: dict[str, Any]
    state: Packed
    history: list[Arrays]


class Store:
    """The checkpoint files of one shard of a job.

    Args:
        job: the folder of the job.
        shard: the number of the shard, from 0.
    """

    def __init__(self, job: Path, shard: int = 0) -> None:
        self.folder = job / FOLDER / str(shard)
        self._own = START

    def load(self) -> tuple[Checkpoint | None, list[str]]:
        """The newest valid checkpoint, and one line for each damaged one."""
        found: list[tuple[dict[str, Any], Packed]] = []
        damaged: list[str] = []
        for name in SLOTS:
            path = self.folder / name
            try:
                found.append(from_bytes(path.read_bytes()))
            except FileNotFoundError:
                continue
            except (DamagedError, OSError) as error:
                damaged.append(f"{path}: {first_line(error)}")
        for header, state in sorted(found, key=lambda pair: -pair[0]["store"]["number"]):
            own = header["store"]
            try:
                history = self._read(own["length"], own["seal"])
            except (DamagedError, OSError) as error:
                damaged.append(f"{self.folder / HISTORY}: {error}")
                continue
            self._own = own
            return Checkpoint(header, state, history), damaged
        return None, damaged

    def lost(self) -> bool:
        """Whether the history that earlier checkpoints rely on is no longer there."""
        try:
            return (self.folder / HISTORY).stat().st_size < self._own["length"]
        except OSError:
            return self._own["length"] > 0

    def save(self, header: Mapping[str, Any], state: Packed, history: Arrays) -> None:
        """Write a checkpoint; if that fails, the earlier ones stay valid.

        Args:
            header: facts needed before the state is loaded, as JSON.
            state: the state to resume from.
            history: the episodes since the previous checkpoint.

        Raises:
            OSError: if the checkpoint cannot be written.
        """
        self.folder.parent.mkdir(exist_ok=True)
        self.folder.mkdir(exist_ok=True)
        length, seal = self._append(history)
        own = {"number": self._own["number"] + 1, "length": length, "seal": seal}
        data = to_bytes({**header, "store": own}, state)
        write_whole(self.folder / SLOTS[own["number"] % 2], data)
        self._own = own

    def clear(self) -> None:
        """Remove all checkpoints."""
        for name in SLOTS:  # first: a state without its history is not a checkpoint
            with suppress(OSError):  # no file, or a folder
                (self.folder / name).unlink()
        if self.folder.exists():
            shutil.rmtree(self.folder)
        self._own = START

    def _append(self, history: Arrays) -> tuple[int, str]:
        """Append a part to the history; return its new length and digest."""
        length, seal = self._own["length"], self._own["seal"]
        if not any(array.size for array in history.values()):
            return length, seal
        data = to_bytes({}, Packed("null", history))
        with (self.folder / HISTORY).open("r+b" if length else "wb") as file:
            file.truncate(length)  # drop what a failed attempt may have written
            file.seek(length)
            file.write(len(data).to_bytes(8, "little"))
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        return length + 8 + len(data), _chained(seal, data)

    def _read(self, length: int, expected: str) -> list[Arrays]:
        """The parts of the first ``length`` bytes of the history."""
        parts: list[Arrays] = []
        seal, place = START["seal"], 0
        if length == 0:
            return parts
        with (self.folder / HISTORY).open("rb") as file:
            while place < length:
                size = int.from_bytes(file.read(8), "little")
                place += 8 + size
                if place > length:
                    raise DamagedError("its length is wrong")
                data = file.read(size)
                seal = _chained(seal, data)
                parts.append(from_bytes(data)[1].arrays)
        if seal != expected:
            raise DamagedError("its checksum is wrong")
        return parts


def _chained(seal: str, data: bytes) -> str:
    """The digest of a history with one more part."""
    return hashlib.sha256(bytes.fromhex(seal) + data).hexdigest()
