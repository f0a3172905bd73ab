"""What only playing can tell: whether an environment has masks, and whether it is reproducible."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np

from trl_explore.envs.copies import Copies, EnvError, Make, Signals
from trl_explore.envs.flattening import Actions
from trl_explore.numerics.streams import Stream


def has_masks(id: str, make: Make, actions: Actions, n_features: int, trial: int) -> bool:
    """Whether an environment returns ``info["action_mask"]`` at its first reset or step.

    A separate copy is played, so that all lanes start from the same state.

    Args:
        id: gymnasium id.
        make: the constructor.
        actions: the actions of the environment.
        n_features: the length of an observation.
        trial: the trial whose first episode is played.

    Raises:
        EnvError: if the reset fails, or returns what it must not.
    """
    probe = _Probe(id, make, Signals.of(1, n_features, 0))
    try:
        probe.reset([0], [trial], [0], 0, Stream.ENVIRONMENT)
        if not probe.masks:
            with suppress(EnvError):  # training meets the same error, and reports it
                probe.step([0], actions.read(np.zeros(1, np.int64)))
        return probe.masks
    finally:
        probe.close()


class _Probe(Copies):
    """A copy that notes whether an environment returns masks."""

    masks = False

    def _check_info(self, row: int, info: Any) -> None:
        self.masks |= "action_mask" in info
