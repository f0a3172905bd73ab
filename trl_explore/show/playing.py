"""One episode of an agent of a finished job, after any number of its iterations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray

from trl_explore.collectors import EpisodeCollector
from trl_explore.config import ConfigError, build_trainer
from trl_explore.config.composing import RecordedJob
from trl_explore.envs import LaneVectorEnv
from trl_explore.envs.gym import make_gym
from trl_explore.envs.seeding import Source
from trl_explore.jobs.records import read_weights
from trl_explore.training.evaluation import FINAL, SCHEDULED, episode_number
from trl_explore.training.trainer import Trainer


@dataclass(frozen=True, eq=False)
class Episode:
    """An episode that an agent has played.

    Attributes:
        trial: the trial.
        iteration: how many updates its weights have had.
        stopped: whether the trial stopped then, possibly before the iteration that was asked for.
        number: the number of the episode, from which its random streams follow.
        action: [frames], or [frames, n_dims] where continuous.
        exploratory: whether an action is not of largest logit [frames]; None where continuous.
        reward: [frames].
        terminated: whether the environment ended it, not the time limit.
        lanes: the environment, with one lane.
    """

    trial: int
    iteration: int
    stopped: bool
    number: int
    action: NDArray[Any]
    exploratory: NDArray[np.bool_] | None
    reward: NDArray[np.float64]
    terminated: bool
    lanes: LaneVectorEnv

    @property
    def score(self) -> float:
        """The undiscounted return."""
        return float(self.reward.sum())


def play(
    job: RecordedJob, trial: int, iteration: int | None = None, *, greedy: bool = False
) -> Episode:
    """Let an agent of a job play an episode.

    With its strategy, it is the training episode that follows the iteration, number for number.
    Without, it is the first episode of the evaluation after the iteration, and the first of the
    final evaluation for the final policy.

    The weights are those of the job's files. Where these have none for the iteration, or the
    strategy has learned from data too, the trial is trained again until then.

    Args:
        job: the job.
        trial: the number of the trial, as in ``trials.csv``.
        iteration: play after this iteration, or after the last if the trial stopped before; None:
            after the last.
        greedy: play the policy alone, by its preferred actions.

    Raises:
        ConfigError: if the job has no such trial or iteration, or the trial has diverged.
    """
    rows = job.trials.set_index("trial")
    if trial not in rows.index:
        first, last = rows.index[0], rows.index[-1]
        raise ConfigError(f"{job.folder}: --trial must be from {first} to {last}, got {trial}")
    last = int(rows["iterations"].to_dict()[trial])
    final = iteration is None
    at = last if iteration is None else min(iteration, last)
    if at == last and rows["status"].to_dict()[trial] == "diverged":
        raise ConfigError(f"{job.folder}: trial {trial} has diverged; it has no final policy")
    player = _player(job, trial, at, last)
    try:
        if greedy:
            assert player.evaluator is not None
            collector = player.evaluator.collector
            number = episode_number(FINAL if final else SCHEDULED, at, 0)
        else:
            collector, number = player.collector, at * player.collector.episodes_per_update
        return episode_of(collector, number, trial, at, at == last)
    finally:
        player.close()


def _player(job: RecordedJob, trial: int, at: int, last: int) -> Trainer:
    """The trainer of a trial, with its weights and its strategy after the iteration ``at``."""
    config, row = job.config.copy(), trial - job.config.first_trial
    config.evaluate_every, config.evaluate_policy = 1, "greedy"  # so that there is an evaluator
    player = build_trainer(config, slice(row, row + 1))
    policy: Any = player.collector.policy[0]
    strategy = player.collector.strategy
    timed = any(schedule.clock == "frames" for schedule in strategy.schedules.values())
    weights = _recorded(job, row, at, last)
    if weights is not None and not (strategy.learns_from_data or timed):
        for name, parameter in policy.named_parameters():
            parameter.data.copy_(torch.from_numpy(weights[name][None]))
        for _ in range(at):
            strategy.step()
        return player
    again = job.trainer(trial)
    try:
        again.run(lambda: again.trials.iteration >= at)
        policy.load_state_dict(again.collector.policy[0].state_dict())
        strategy.load_state_dict(again.collector.strategy.state_dict())
    finally:
        again.close()
    return player


def _recorded(job: RecordedJob, row: int, at: int, last: int) -> dict[str, NDArray[Any]] | None:
    """The weights of a trial in the files of its job; None if they are not those after ``at``."""
    if at == last:
        return {name: values[row] for name, values in read_weights(job.folder).items()}
    kept = read_weights(job.folder, kept=True)
    names = [name for name in kept if name.split("/")[0] == str(at)]
    return {name.partition("/")[2]: kept[name][row] for name in names} or None


def episode_of(
    collector: EpisodeCollector, number: int, trial: int, at: int, stopped: bool
) -> Episode:
    """The episode ``number`` of a collector of one trial; see ``Episode`` for the arguments."""
    collector.episodes[:] = number
    rollout = collector.collect()
    frames: Any = rollout.frames[: int(rollout.length.reshape(-1)[0])]
    return Episode(
        trial=trial,
        iteration=at,
        stopped=stopped,
        number=number,
        action=frames["action"].numpy().copy(),
        exploratory=_exploratory(collector.policy[0], frames),
        reward=frames["next", "reward"].double().reshape(-1).numpy().copy(),
        terminated=bool(frames["next", "terminated"][-1]),
        lanes=collector.lanes,
    )


@torch.no_grad()
def _exploratory(policy: Any, frames: Any) -> NDArray[np.bool_] | None:
    """Whether each action differs from those that the policy prefers."""
    logits = policy(frames.clone()).get("logits", None)
    if logits is None:
        return None
    mask = frames.get("action_mask", None)
    if mask is not None:
        logits = logits.masked_fill(~mask, -torch.inf)
    taken = logits.gather(-1, frames["action"].unsqueeze(-1)).squeeze(-1)
    return (taken < logits.amax(-1)).numpy()


def replayed(
    episode: Episode, see: Callable[[gym.Env, Any], Any], *, render_mode: str | None = None
) -> list[Any]:
    """What ``see(env, observation)`` returns before every action and after the last.

    The environment is played again from the episode's own random stream, with its actions.
    """
    lanes = episode.lanes
    id, max_steps, kwargs, *others = lanes.make.args
    mode = {} if render_mode is None else {"render_mode": render_mode}
    env = make_gym(id, max_steps, {**kwargs, **mode}, *others)
    try:
        observation, _ = Source(env).reset(lanes.seed, lanes.stream, episode.trial, episode.number)
        seen = [see(env, observation)]
        for action in lanes.actions.read(episode.action):
            observation, _, terminated, truncated, _ = env.step(action)
            seen.append(see(env, observation))
            if terminated or truncated:
                break
        return seen
    finally:
        env.close()
