"""The lanes: one copy of an environment per trial, as a gymnasium VectorEnv."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from math import isfinite
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box, Discrete
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from trl_explore.checks import LARGEST, check_integer
from trl_explore.envs.copies import Copies, EnvError, Make, Outputs
from trl_explore.envs.flattening import Actions, UnsupportedSpaceError, flat_observations
from trl_explore.envs.gym import make_gym, time_limit
from trl_explore.envs.processes import ProcessCopies, worker_count
from trl_explore.numerics.streams import Stream, generator


class LaneVectorEnv(VectorEnv):
    """n independent copies of a gymnasium environment, each stepped only while it is unfinished.

    Unlike gymnasium's vector environments it keeps trials independent. A finished lane is not
    stepped and keeps its last observation until it is reset by ``options["reset_mask"]``
    (autoreset is disabled). Every episode of every lane has its own random stream,
    ``streams.generator(seed, stream, trial, episode)``, so that an episode depends only on the
    seed, its trial, its number and the actions.

    Observations are vectors (``flattening.flat_observations``), and actions are what the
    environment expects (``flattening.Actions``); what it returns is checked (``Copies``).

    An environment that returns ``info["action_mask"]`` at its first reset or step has masks: the
    lanes' ``info`` then has "action_mask" [n, n_actions], bool, False where an action is not
    allowed. If the last observation of an episode allows no action, the mask is all True, since no
    action is taken there.

    Args:
        num_envs: number of lanes; the other arguments are those of ``make_env``.

    Raises:
        ValueError: if an argument is invalid; later, if an observation, a reward or an action is
            not finite, or a mask forbids every action; the message names environment and trial.
        RuntimeError: if an environment fails in a worker process.
    """

    def __init__(
        self,
        id: str,
        num_envs: int,
        max_steps: int | None = None,
        *,
        seed: int = 0,
        first_trial: int = 0,
        kwargs: Mapping[str, Any] | None = None,
        attributes: Mapping[str, Any] | None = None,
        wrappers: Sequence[Callable[[gym.Env], gym.Env]] = (),
        stream: Stream = Stream.ENVIRONMENT,
        workers: int | None = 1,
    ) -> None:
        check_integer("num_envs", num_envs, 1)
        check_integer("first_trial", first_trial, 0, LARGEST - num_envs)
        check_integer("seed", seed, 0)
        self.workers = worker_count(workers, num_envs)
        make = partial(
            make_gym, id, max_steps, dict(kwargs or {}), dict(attributes or {}), tuple(wrappers)
        )
        self.make = make
        # A collector that compiles the environment never steps the lanes: build them on first use.
        env = make()
        self.id, self.max_steps = id, time_limit(id, env, max_steps)
        self.num_envs = num_envs
        self.spec = env.spec
        self.metadata = {**env.metadata, "autoreset_mode": AutoresetMode.DISABLED}
        self.autoreset_mode = AutoresetMode.DISABLED
        try:
            self.actions = Actions(env.action_space)
            self.single_observation_space = flat_observations(env.observation_space)
        except UnsupportedSpaceError as error:
            raise UnsupportedSpaceError(f"environment {id!r} has {error}") from None
        self.single_action_space = self.actions.space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.first_trial = first_trial
        self.stream = stream
        self.reseed(seed)
        n_features = self.single_observation_space.shape[0]
        self.has_masks, masked = False, 0
        if isinstance(env.action_space, Discrete):
            self.has_masks = _has_masks(id, make, n_features, first_trial)
            masked = int(env.action_space.n) if self.has_masks else 0
        shape = (num_envs, n_features, masked)
        if self.workers == 1:
            self.outputs = Outputs.of(*shape)
            self._copies = Copies(id, make, self.outputs, env)
        else:
            self._copies = ProcessCopies(id, make, env, shape, self.workers)
            self.outputs = self._copies.all
        self._flat = self.outputs.observation.reshape(-1)
        self.running = np.zeros(num_envs, dtype=np.bool_)
        """Whether a lane's episode is unfinished [num_envs]."""
        self._continuous = isinstance(self.single_action_space, Box)

    @property
    def envs(self) -> list[gym.Env]:
        """The copies built in this process; there is always at least one."""
        return self._copies.envs

    def reseed(self, seed: int) -> None:
        """Restart every lane at episode 0 of its trial with ``seed``."""
        generator(seed, self.stream, 0)  # raises if the seed is invalid
        self.seed = int(seed)
        self.episodes = np.zeros(self.num_envs, dtype=np.int64)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        """Begin the next episode in the lanes of ``options["reset_mask"]``, or in all lanes."""
        if seed is not None:
            self.reseed(seed)
        mask = (options or {}).get("reset_mask")
        self.begin(np.arange(self.num_envs) if mask is None else np.flatnonzero(mask))
        self.check()
        return self.outputs.observation.copy(), self._info()

    def step(
        self, actions: NDArray[Any]
    ) -> tuple[
        NDArray[Any], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]
    ]:
        """Step the unfinished lanes; a finished one repeats its last observation with reward 0."""
        outputs = self.outputs
        outputs.reward[:] = 0
        lanes = np.flatnonzero(self.running)
        self.advance(lanes, np.asarray(actions)[lanes])
        self.check()
        return (
            outputs.observation.copy(),
            outputs.reward.copy(),
            outputs.terminated.copy(),
            outputs.truncated.copy(),
            self._info(),
        )

    def begin(self, lanes: NDArray[np.int64]) -> None:
        """Begin the episode ``episodes[k]`` in some lanes; ``outputs`` then has their start.

        A collector that calls ``begin`` and ``advance`` reads ``outputs`` in place, and calls
        ``check`` after each, unless it checks by itself that the observations are finite.

        Raises:
            EnvError: if an environment fails, or returns what it must not; one line with the
                environment, the trial and the episode.
        """
        self._copies.reset(
            lanes.tolist(),
            (self.first_trial + lanes).tolist(),
            self.episodes[lanes].tolist(),
            self.seed,
            self.stream,
        )
        self.episodes[lanes] += 1
        self.running[lanes] = True

    def advance(self, lanes: NDArray[np.int64], actions: NDArray[Any]) -> None:
        """Step some unfinished lanes with their actions [m] or [m, n_dims]; fills ``outputs``.

        The rows of other lanes stay as they are.

        Raises:
            EnvError: as for ``begin``, or if an action is not finite.
        """
        if self._continuous and not np.isfinite(actions).all():
            k = int(np.flatnonzero(~np.isfinite(actions).all(axis=1))[0])
            raise self._error(lanes[k], f"got the non-finite action {actions[k].tolist()}")
        if self._copies.step(lanes.tolist(), actions):
            outputs = self.outputs
            self.running[lanes] = ~(outputs.terminated[lanes] | outputs.truncated[lanes])

    def _info(self) -> dict[str, Any]:
        return {"action_mask": self.outputs.mask.copy()} if self.has_masks else {}

    def check(self) -> None:
        """Reject non-finite observations, and masks that forbid every action.

        Raises:
            EnvError: with environment, episode and trial.
        """
        # A sum of squares is fast, and not finite if one of them is not.
        if not isfinite(self._flat.dot(self._flat)):
            self._check_finite(self.outputs.observation, "returned observation")
        if self.has_masks and not (some := self.outputs.mask.any(axis=1)).all():
            stuck = np.flatnonzero(~some & self.running)
            if len(stuck):
                raise self._error(
                    int(stuck[0]), "returned an action mask that forbids every action"
                )
            self.outputs.mask[~some] = True

    def check_transformed(self, observation: NDArray[Any], reward: NDArray[Any]) -> None:
        """Reject what transforms have made of finite numbers, if it is not finite.

        Raises:
            EnvError: with environment, episode and trial.
        """
        self._check_finite(observation, "has transforms that make observation")
        self._check_finite(reward.reshape(-1, 1), "has transforms that make reward")

    def _check_finite(self, values: NDArray[Any], what: str) -> None:
        """Reject values [num_envs, n] that are not finite."""
        finite = np.isfinite(values)
        if not finite.all():
            lane, i = (int(k[0]) for k in np.nonzero(~finite))
            raise self._error(lane, f"{what}[{i}] = {values[lane, i]}")

    def _error(self, lane: int, what: str) -> EnvError:
        trial, episode = self.first_trial + int(lane), int(self.episodes[lane]) - 1
        return EnvError.placed(self.id, what, trial, episode)

    def close_extras(self, **kwargs: Any) -> None:
        """Close every lane."""
        self._copies.close()


def _has_masks(id: str, make: Make, n_features: int, trial: int) -> bool:
    """Whether an environment returns ``info["action_mask"]`` at its first reset or step.

    A separate copy plays the first episode of the trial, so that all lanes start from one state.

    Raises:
        EnvError: if the reset fails, or returns what it must not.
    """
    probe = _Probe(id, make, Outputs.of(1, n_features, 0))
    try:
        probe.reset([0], [trial], [0], 0, Stream.ENVIRONMENT)
        if not probe.masks:
            with suppress(EnvError):  # training meets the same error, and reports it
                probe.step([0], np.zeros(1, np.int64))
        return probe.masks
    finally:
        probe.close()


class _Probe(Copies):
    """A copy that notes whether an environment returns masks."""

    masks = False

    def _check_info(self, row: int, info: Any) -> None:
        self.masks |= "action_mask" in info
