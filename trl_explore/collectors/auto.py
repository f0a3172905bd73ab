"""The fused collector where it applies, and the TorchRL collector elsewhere."""

from __future__ import annotations

import logging
from typing import Any

from tensordict.nn import TensorDictSequential
from torchrl.envs import TransformedEnv

from trl_explore.collectors.collector import EpisodeCollector
from trl_explore.collectors.fused.collector import FusedCollector, NotCompilableError
from trl_explore.collectors.torchrl import TorchRLCollector

logger = logging.getLogger(__name__)


def auto_collector(
    env: TransformedEnv,
    policy: TensorDictSequential,
    *,
    announce: bool = True,
    **options: Any,
) -> EpisodeCollector:
    """The fastest collector that applies; one log line names it, and says why it is not fused.

    Args:
        env: an environment made by ``envs.make_env``.
        policy: ``TensorDictSequential(policy, strategy)``.

    Keyword Args:
        announce: whether to write the log line.
        options: the arguments of ``EpisodeCollector``.
    """
    try:
        collector = FusedCollector(env, policy, **options)
        line = "collector: fused"
    except NotCompilableError as error:
        collector = TorchRLCollector(env, policy, **options)
        line = f"collector: torchrl (the fused collector does not apply: {error})"
    if announce:
        logger.info(line)
    return collector
