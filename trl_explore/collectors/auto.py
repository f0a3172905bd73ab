"""The choice of the collector: the fastest that applies."""

from __future__ import annotations

import logging
from typing import Any

from tensordict.nn import TensorDictSequential
from torchrl.envs import TransformedEnv

from trl_explore.collectors.collector import EpisodeCollector
from trl_explore.collectors.compilable import NotCompilableError
from trl_explore.collectors.fused.collector import FusedCollector
from trl_explore.collectors.stepping.collector import SteppingCollector
from trl_explore.collectors.torchrl import TorchRLCollector

logger = logging.getLogger(__name__)

COLLECTORS = ((FusedCollector, "fused"), (SteppingCollector, "stepping"))
"""The collectors that may not apply, the fastest first."""


def auto_collector(
    env: TransformedEnv,
    policy: TensorDictSequential,
    *,
    announce: bool = True,
    **options: Any,
) -> EpisodeCollector:
    """The fastest collector that applies; one log line names it, and says why no faster one does.

    Args:
        env: an environment made by ``envs.make_env``.
        policy: ``TensorDictSequential(policy, strategy)``.

    Keyword Args:
        announce: whether to write the log line.
        options: the arguments of ``EpisodeCollector``.
    """
    reasons: list[str] = []
    for kind, name in COLLECTORS:
        try:
            collector = kind(env, policy, **options)
            break
        except NotCompilableError as error:
            reasons.append(f"{name} does not apply: {error}")
    else:
        collector, name = TorchRLCollector(env, policy, **options), "torchrl"
    if announce:
        why = f" ({'; '.join(reasons)})" if reasons else ""
        logger.info("collector: %s%s", name, why)
    return collector
