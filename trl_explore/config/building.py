"""Build the objects of a job from its configuration."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, Any, cast

from hydra.utils import instantiate
from omegaconf import DictConfig, ListConfig, OmegaConf

from trl_explore.checks import check_number
from trl_explore.config.checking import check_actions, check_values
from trl_explore.config.constructors import calling, constructor_of
from trl_explore.config.files import ConfigError, load, same
from trl_explore.config.importing import import_torchrl

if TYPE_CHECKING:
    from torch import nn
    from torchrl.envs import TransformedEnv

    from trl_explore.objectives.baselines import Baseline
    from trl_explore.training.evaluation import Evaluator
    from trl_explore.training.intrinsic import CountReward
    from trl_explore.training.shards import Shards
    from trl_explore.training.trainer import Trainer

logger = logging.getLogger(__name__)

SHARED = ("kwargs", "attributes", "wrappers", "transforms")
"""The keys of ``env`` that ``train.yaml`` gives every environment, empty by default."""
PARTS = {
    "wrappers": "gymnasium.wrappers.TimeAwareObservation",
    "transforms": "torchrl.envs.SignTransform",
}
"""The keys of ``env`` that hold a list of constructors, each with an example."""
STOPPING = ("max_iterations", "score_threshold", "score_window", "evaluate_confirm")
"""The keys of an environment's file that belong to the rules; the trainer uses them."""


def fill_threshold(config: DictConfig) -> None:
    """If the configuration has no score threshold, set the one that gymnasium registers.

    Raises:
        ConfigError: if gymnasium registers none.
    """
    from trl_explore.envs.gym import reward_threshold

    id = config.env.get("id", "")
    if "id" in config.env and (not isinstance(id, str) or not id.strip()):
        raise ConfigError(
            f"env.id must be the name of an environment, e.g. env.id=Acrobot-v1, got {id!r}"
        )
    if config.score_threshold is not None or not id:
        return
    threshold = calling("env", lambda: reward_threshold(id))
    if threshold is None:
        raise ConfigError(
            f"score_threshold must be set, e.g. score_threshold=100: gymnasium has none for {id!r}"
        )
    config.score_threshold = threshold


def build_shards(config: DictConfig, sizes: Sequence[int] | None = None) -> Shards:
    """Build everything that a job needs from its configuration.

    Args:
        config: the configuration.
        sizes: the sizes of the shards; None: chosen from the numbers of trials and threads.

    Raises:
        ConfigError: if a value is not allowed; nothing has been trained or written.
    """
    _prepare(config)
    from trl_explore.training.shards import Shards, partition

    chosen = sizes or partition(config.trials, config.threads)
    trainers = [_build_trainer(config, slice(0, chosen[0]))]
    if sizes is None and len(chosen) > 1 and not trainers[0].parallel:  # one shard is faster
        trainers.pop().close()
        chosen = [config.trials]
    edges = [0, *accumulate(chosen)]
    for low, high in list(pairwise(edges))[len(trainers) :]:
        trainers.append(_build_trainer(config, slice(low, high), announce=False))
    return Shards(trainers)


def build_trainer(
    config: DictConfig, rows: slice | None = None, env: TransformedEnv | None = None
) -> Trainer:
    """Build one trainer.

    Args:
        config: the configuration of a job.
        rows: some of its trials; None: all.
        env: the environment of a trainer of equally many trials of the same job whose
            collector is a ``FusedCollector``, which never steps it; None: build it.

    Raises:
        ConfigError: if a value is not allowed.
    """
    _prepare(config)
    return _build_trainer(config, rows or slice(0, config.trials), env, announce=rows is None)


def _prepare(config: DictConfig) -> None:
    import_torchrl()
    fill_threshold(config)
    check_values(config)


def _build_trainer(
    config: DictConfig, rows: slice, env: TransformedEnv | None = None, *, announce: bool = True
) -> Trainer:
    """Build the trainer of some of the trials; only one of a job's announces the collector."""
    from tensordict.nn import TensorDictSequential

    from trl_explore.collectors import FusedCollector
    from trl_explore.envs import lane_env
    from trl_explore.envs.checking import remarks
    from trl_explore.policies.actor import actor_of
    from trl_explore.policies.layers import spec_env
    from trl_explore.training.diagnostics import Diagnostics
    from trl_explore.training.snapshots import Snapshots, Visits
    from trl_explore.training.trainer import Trainer
    from trl_explore.training.trials import Trials

    size = rows.stop - rows.start
    trials = calling(
        None,
        lambda: Trials(
            size,
            max_iterations=config.max_iterations,
            score_threshold=config.score_threshold,
            score_window=config.score_window,
            stop_on=config.stop_on,
        ),
    )
    streams = {"seed": config.seed, "first_trial": config.first_trial + rows.start}
    strategy = constructor_of(config, "strategy")()
    if size < config.trials:
        calling("strategy", lambda: strategy.take(rows, config.trials))
    make = _environment(config)
    if announce:
        _check_transforms(config, make)
    if env is None:
        env = cast("TransformedEnv", make(trials=size, **streams))
    else:
        lane_env(env).first_trial = streams["first_trial"]
    check_actions(config, spec_env(env).action_spec.domain)
    policy = _policy(config)(env=env, **streams)
    baseline = constructor_of(config, "baseline")()
    baseline.bind(env)
    optimizer = constructor_of(config, "optimizer")(_parameters(policy, baseline))
    actor = actor_of(policy)
    correction = constructor_of(config, "correction")()
    calling("correction", lambda: correction.take(rows, config.trials))
    loss = constructor_of(config, "loss")(
        actor, correction=correction, baseline=baseline, strategy=strategy, trials=size
    )
    auto = config.collector.get("_target_") == load("collector/auto")["_target_"]
    quiet = {"announce": False} if auto and not announce else {}
    both = TensorDictSequential(policy, strategy)
    collector = constructor_of(config, "collector")(env, both, **quiet)
    if announce and not isinstance(collector, FusedCollector):  # that one has no copies
        for line in calling("env", lambda: remarks(collector.lanes)):
            logger.info(line)
    diagnostics = None
    if config.diagnostics:
        visits = Visits(env, size)
        diagnostics = Diagnostics(actor, strategy, size, policy.parameters(), visits)
    kept, cap = config.keep_weights, config.max_iterations
    parts = {
        "evaluator": _evaluator(config, env, policy, strategy, size, streams),
        "diagnostics": diagnostics,
        "intrinsic": calling(None, lambda: _intrinsic(config, env, policy, size, streams)),
        "snapshots": calling(None, lambda: Snapshots(policy, kept, cap)) if kept else None,
    }
    return calling(None, lambda: Trainer(collector, loss, optimizer, trials, **parts))


def _policy(config: DictConfig) -> Callable[..., Any]:
    """The constructor of the policy; its learning rate is for the optimiser."""
    plain = cast(
        dict[str, Any], OmegaConf.to_container(config.policy, resolve=True, throw_on_missing=True)
    )
    plain.pop("lr", None)
    return constructor_of({"policy": plain}, "policy")


def _environment(config: DictConfig) -> Callable[..., Any]:
    """The constructor of the environment, with its wrappers and transforms."""
    env = config.env
    for key in PARTS:
        _check_parts(key, env.get(key))
    for key in ("kwargs", "attributes"):
        if not isinstance(env.get(key), DictConfig | None):
            form = f"env.{key}={{name: value}}"
            raise ConfigError(f"env.{key} must map names to values, {form}, got {env[key]!r}")
    # Without the constructor's defaults: the user's own one may not know the key.
    without = [*STOPPING, "target", *(key for key in SHARED if not env.get(key))]
    if same(env.get("workers"), 1):
        without.append("workers")
    plain = cast(dict[str, Any], OmegaConf.to_container(env, resolve=True))
    for wrapper in plain.get("wrappers") or []:
        wrapper["_partial_"] = True
    plain = {key: value for key, value in plain.items() if key not in without}
    return constructor_of({"env": plain}, "env")


def _check_transforms(config: DictConfig, make: Callable[..., Any]) -> None:
    """Reject transforms that mix trials, or fail; each error names the transform."""
    from trl_explore.envs.checking import check_transforms

    def build() -> list[Any]:
        return [instantiate(node, _convert_="all") for node in nodes]

    if nodes := config.env.get("transforms"):
        calling("env", lambda: check_transforms(build, partial(make, seed=config.seed)))


def _check_parts(key: str, nodes: Any) -> None:
    """Reject wrappers or transforms that are not a list of constructors."""
    if nodes is None:
        return
    form = f"env.{key}=[{{_target_: {PARTS[key]}, ...}}]"
    if not isinstance(nodes, ListConfig):
        raise ConfigError(f"env.{key} must be a list, {form}, got {nodes!r}")
    for k, node in enumerate(nodes):
        if not isinstance(node, DictConfig) or not isinstance(node.get("_target_"), str):
            raise ConfigError(f"env.{key}[{k}] must name a class, {form}, got {node!r}")


def _intrinsic(
    config: DictConfig, env: Any, policy: Any, trials: int, streams: Mapping[str, int]
) -> CountReward | None:
    """Build the intrinsic reward; None if it is off."""
    from trl_explore.training.intrinsic import CountReward

    beta = check_number("intrinsic_reward", config.intrinsic_reward, 0)
    if not beta:
        return None
    if env.action_spec.domain != "discrete":
        raise ValueError(f"intrinsic_reward counts discrete actions, got {env.action_spec.domain}")
    tabular = bool(getattr(policy, "tabular", False))
    return CountReward(beta, trials, env.action_spec.space.n, one_hot=tabular, **streams)


def _evaluator(
    config: DictConfig, env: Any, policy: Any, strategy: Any, size: int, streams: Mapping[str, int]
) -> Evaluator | None:
    """Build the evaluator; None if evaluation is off."""
    from tensordict.nn import TensorDictSequential
    from torchrl.envs.utils import ExplorationType

    from trl_explore.collectors import FusedCollector, NotCompilableError, auto_collector
    from trl_explore.numerics.streams import Stream
    from trl_explore.training.evaluation import Evaluator, acting

    if not config.evaluate_every:
        return None
    modules = cast(Any, acting(strategy, config.evaluate_policy))
    both = TensorDictSequential(policy, modules)
    greedy = config.evaluate_policy == "greedy"
    options = {
        "exploration_type": ExplorationType.DETERMINISTIC if greedy else ExplorationType.RANDOM
    }
    try:
        collector = FusedCollector(env, both, stream=Stream.EVALUATION, **options)
    except NotCompilableError as error:
        if config.evaluate_every == "auto":
            if (episodes := config.evaluate_episodes) != load("train").evaluate_episodes:
                raise ConfigError(
                    f"evaluate_episodes={episodes} needs evaluations, but evaluate_every=auto has"
                    f" none without a compiled kernel ({error}); give an integer >= 1"
                ) from None
            return None
        other = _environment(config)(trials=size, stream=Stream.EVALUATION, **streams)
        collector = auto_collector(other, both, announce=False, **options)
    return calling(
        None,
        lambda: Evaluator(
            collector,
            every=config.evaluate_every,
            episodes=config.evaluate_episodes,
            most=config.evaluate_confirm,
            threshold=config.score_threshold,
            max_iterations=config.max_iterations,
        ),
    )


def _parameters(policy: nn.Module, baseline: Baseline) -> Iterable[Any]:
    """The parameters to optimise: the policy, and the baseline with its own learning rate."""
    learned = list(baseline.parameters())
    if not learned:
        return policy.parameters()
    return [{"params": list(policy.parameters())}, {"params": learned, "lr": baseline.lr}]
