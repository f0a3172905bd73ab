"""What is kept along the way: the weights of the trials, and where they have been."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torch import nn
from torchrl.envs import EnvBase

from trl_explore.checks import check_integer
from trl_explore.envs import lane_env
from trl_explore.policies.layers import is_one_hot, spec_env
from trl_explore.training.diagnostic_quantities import BINS, PLANES

Weights = dict[str, NDArray[Any]]


class Snapshots:
    """Copies of the policy's parameters after chosen iterations.

    Args:
        policy: the policy of n trials.
        iterations: after which of them to copy the parameters; 0: before the first update.
        max_iterations: the cap of the trials.

    Raises:
        ValueError: if an iteration is not an integer from 0 to the cap.
    """

    def __init__(self, policy: nn.Module, iterations: Iterable[int], max_iterations: int) -> None:
        self.policy = policy
        name = "an iteration of keep_weights"
        found = {check_integer(name, i, 0, max_iterations) for i in iterations}
        self.iterations = sorted(found)
        self.kept: dict[int, Weights] = {}
        """Iteration -> name of a parameter -> its values [n, ...]."""

    def record(self, iteration: int) -> None:
        """Copy the parameters, if those of this iteration are wanted."""
        if iteration in self.iterations:
            self.kept[iteration] = self._now()

    def after(self, iteration: int) -> Weights:
        """The parameters after an iteration, or after the last one if training ended before."""
        return self.kept.get(iteration) or self._now()

    def _now(self) -> Weights:
        return {k: p.detach().numpy().copy() for k, p in self.policy.named_parameters()}

    def state_dict(self) -> dict[str, Any]:
        """The copies so far, and the iterations that are wanted."""
        return {"kept": self.kept, "iterations": self.iterations}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore a ``state_dict``: training goes on with the iterations with which it began."""
        self.iterations = list(state["iterations"])
        self.kept = {int(i): dict(weights) for i, weights in state["kept"].items()}

    @staticmethod
    def joined(parts: Sequence[Snapshots]) -> Weights | None:
        """The copies of all shards, by "iteration/name" [trials, ...]; None if there are none.

        A trial that stopped earlier has the weights with which it stopped.
        """
        if not parts:
            return None
        found: Weights = {}
        for i in sorted(set.intersection(*(set(part.iterations) for part in parts))):
            rows = [part.after(i) for part in parts]
            for name in rows[0]:
                found[f"{i}/{name}"] = np.concatenate([row[name] for row in rows])
        return found


class Visits:
    """How often each cell of the observations has been visited, up to iterations 1, 2, 4 and so on.

    A cell is a one-hot state, or a cell of a histogram of the two features that ``PLANES`` names
    for the environment, 32 × 32; values beyond its limits count at the edge. Other environments
    have no cells, and nothing is recorded.

    Args:
        env: an environment of ``make_env``.
        trials: the number of trials.

    Attributes:
        shape: rows and columns of the cells; None if there are none.

    Example:
        >>> from trl_explore.envs import make_env
        >>> Visits(make_env("FrozenLake-v1", trials=3), trials=3).shape
        (4, 4)
    """

    def __init__(self, env: EnvBase, trials: int) -> None:
        self.one_hot, self.plane = is_one_hot(env), PLANES.get(lane_env(env).id)
        histogram = (BINS, BINS) if self.plane else None
        self.shape: tuple[int, int] | None = _grid(env) if self.one_hot else histogram
        self.counts = np.zeros((trials, prod(self.shape or (0,))), dtype=np.int64)
        """Visits of every trial so far [trials, cells]."""
        self.iteration = 0
        self._snapshots: list[NDArray[np.int64]] = []

    def record(self, data: TensorDictBase) -> None:
        """Count the frames of an iteration."""
        self.iteration += 1
        if self.shape is None:
            return
        place = data.get("trial").numpy(), self._cells(data.get("observation").numpy())
        np.add.at(self.counts, place, 1)
        if self.iteration & (self.iteration - 1) == 0:
            self._snapshots.append(self._now())

    def _now(self) -> NDArray[np.int64]:
        """Visits of all trials, and the number of trials that were there [2, cells]."""
        return np.stack([self.counts.sum(axis=0), (self.counts > 0).sum(axis=0)])

    def _cells(self, observation: NDArray[np.float32]) -> NDArray[np.int64]:
        if self.one_hot:
            return observation.argmax(axis=-1)
        assert self.plane is not None
        x, y = (
            np.clip((observation[:, f.index] - f.low) / (f.high - f.low) * BINS, 0, BINS - 1)
            for f in self.plane
        )
        return y.astype(np.int64) * BINS + x.astype(np.int64)

    def state_dict(self) -> dict[str, Any]:
        """The counts and the snapshots."""
        empty = np.zeros((0, 2, self.counts.shape[1]), dtype=np.int64)
        snapshots = np.stack(self._snapshots) if self._snapshots else empty
        return {"counts": self.counts.copy(), "iteration": self.iteration, "snapshots": snapshots}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore a ``state_dict``."""
        self.counts = np.asarray(state["counts"]).copy()
        self.iteration, self._snapshots = int(state["iteration"]), list(state["snapshots"])

    @staticmethod
    def joined(parts: Sequence[Visits]) -> dict[str, NDArray[np.int64]] | None:
        """The visits of all shards; None if nothing was recorded.

        Returns:
            "iteration" [k], the last one that of the end; "visits" [k, rows, columns], the frames
            of all trials in each cell until then; "reached", the number of trials that were there.
        """
        shape = parts[0].shape if parts else None
        if shape is None:
            return None
        end = max(part.iteration for part in parts)
        at = [2**k for k in range(end.bit_length()) if 2**k < end]
        tables = []
        for k in range(len(at) + 1):  # a shard that has stopped keeps its counts
            kept = [p._snapshots[: len(at)][k : k + 1] or [p._now()] for p in parts]
            tables.append(np.sum(kept, axis=0)[0])
        visits, reached = np.stack(tables, axis=1).reshape(2, -1, *shape)
        return {"iteration": np.array([*at, end]), "visits": visits, "reached": reached}


def _grid(env: EnvBase) -> tuple[int, int]:
    """The rows and columns of the states, where the environment has them; else one row."""
    inner: Any = lane_env(env).envs[0].unwrapped
    (n_states,) = spec_env(env).observation_spec["observation"].shape[-1:]
    shape = getattr(inner, "shape", None) or np.shape(getattr(inner, "desc", ()))
    if len(shape) == 2 and prod(shape) == n_states:
        return int(shape[0]), int(shape[1])
    return 1, int(n_states)
