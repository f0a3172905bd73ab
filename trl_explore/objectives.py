"""The REINFORCE loss."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Any, cast

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase, TensorDictParams
from tensordict.nn import ProbabilisticTensorDictSequential, dispatch
from torch import Tensor
from torchrl.objectives.common import LossModule

from trl_explore.actor import score_sum
from trl_explore.checks import check_integer, check_number
from trl_explore.ops import return_to_go

REDUCTIONS = ("sum", "mean", "none")


class ReinforceLoss(LossModule):
    """REINFORCE with reward-to-go: one loss for each trial, no critic.

    L_k = −w · Σ_{t ∈ frames of trial k} (G_t − b) · log π(a_t | s_t),
    G_t = Σ_{j ≥ t} γ^{j−t} r_j, to the end of the episode

    (Williams 1992; Sutton & Barto, §13.3; thesis, §2.1 and appendix A.3). The gradient is that of
    the expected return only if the data are on-policy (μ = π) and γ = 1: there is no factor γ^t,
    as in the thesis. Adam divides a constant factor such as w out again, but for its ε = 1e-8.

    An episode ends where "done" is true. *Terminated* and *truncated* episodes are treated alike:
    the return stops with the last reward, nothing is bootstrapped behind a time limit; so is an
    episode that the data break off. Data of two layouts are served:

    * flat [frames], the episodes of one or more trials one after the other ("trial" says whose;
      without it, all frames are one trial's);
    * [batch, time] as TorchRL's collectors deliver it (without "trial", every row is a trial).
      Frames that TorchRL marks as padding, in ("collector", "mask"), count for nothing.

    Reads what the actor reads, "action", ("next", "reward") and ("next", "done") [*batch, 1],
    and "trial" [*batch] int64. Returns "loss_actor" (reduced) and "trial_loss" [trials], the same
    losses before reduction, detached.

    Args:
        actor_network: the target policy π, any ``ProbabilisticActor``.

    Keyword Args:
        gamma: discount γ in [0, 1].
        weight: w > 0; the thesis multiplies the loss with the learning rate (appendix A.3).
        baseline: b, a constant (0 in the thesis).
        trials: the number of trials; None takes the largest "trial" of the data plus one.
        reduction: of the trials' losses: "sum", "mean" or "none".
        functional: as in TorchRL: whether the parameters are copied into the loss's own container.

    Raises:
        ValueError: if a number is out of range or the reduction is unknown.
        KeyError: if the data lack an entry.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule
        >>> from torchrl.modules import ProbabilisticActor
        >>> logits = TensorDictModule(torch.nn.Linear(4, 2), ["observation"], ["logits"])
        >>> actor = ProbabilisticActor(
        ...     logits, in_keys=["logits"], distribution_class=torch.distributions.Categorical
        ... )
        >>> loss = ReinforceLoss(actor, gamma=0.99, weight=1.0)
        >>> end = torch.tensor([False, False, True]).unsqueeze(-1)
        >>> data = TensorDict({
        ...     "observation": torch.randn(3, 4),
        ...     "action": torch.tensor([0, 1, 1]),
        ...     "next": {"reward": torch.ones(3, 1), "done": end},
        ... }, [3])
        >>> loss(data)["loss_actor"].backward()
    """

    @dataclass
    class _AcceptedKeys:
        """The entries that ``set_keys`` can rename."""

        action: NestedKey = "action"
        reward: NestedKey = "reward"
        done: NestedKey = "done"
        trial: NestedKey = "trial"

    tensor_keys: _AcceptedKeys
    default_keys = _AcceptedKeys
    out_keys = ["loss_actor", "trial_loss"]  # noqa: RUF012  # pyright: ignore

    actor_network: ProbabilisticTensorDictSequential
    actor_network_params: TensorDictParams
    target_actor_network_params: TensorDictParams

    def __init__(
        self,
        actor_network: ProbabilisticTensorDictSequential,
        *,
        gamma: float = 0.99,
        weight: float = 0.05,
        baseline: float = 0.0,
        trials: int | None = None,
        reduction: str = "sum",
        functional: bool = True,
    ) -> None:
        super().__init__()
        self._functional = functional
        self._in_keys = None
        self.gamma = check_number("gamma", gamma, 0, 1)
        self.weight = check_number("weight", weight, 0, low_open=True)
        self.baseline = check_number("baseline", baseline)
        self.trials = None if trials is None else check_integer("trials", trials, 1)
        if reduction not in REDUCTIONS:
            raise ValueError(f"reduction must be one of {', '.join(REDUCTIONS)}, got {reduction!r}")
        self.reduction = reduction
        if functional:
            self.convert_to_functional(actor_network, "actor_network", create_target_params=False)
        else:
            self.actor_network = actor_network

    @property
    def functional(self) -> bool:
        """Whether the loss holds a copy of the parameters' container."""
        return self._functional

    @property
    def in_keys(self) -> list[NestedKey]:
        """The entries that a call without a TensorDict takes as keyword arguments."""
        if self._in_keys is None:
            keys = self.tensor_keys
            own = [keys.action, ("next", keys.reward), ("next", keys.done), keys.trial]
            actors = [key for key in self.actor_network.in_keys if key not in own]
            self._in_keys = [*own, *actors]
        return self._in_keys

    @in_keys.setter
    def in_keys(self, values: list[NestedKey]) -> None:
        self._in_keys = values

    def _forward_value_estimator_keys(self, **kwargs: NestedKey) -> None:
        self._in_keys = None

    @dispatch  # pyright: ignore[reportArgumentType] - it is its own decorator
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The losses of a batch of episodes."""
        mask = self._mask(tensordict)
        factor = self._advantage(tensordict, mask).mul_(-self.weight)
        trial, trials = self._trial(tensordict, factor)
        if mask is not None:
            tensordict, factor, trial = tensordict[mask], factor[mask], trial[mask]
        if factor.ndim > 1:
            tensordict = cast(TensorDictBase, tensordict.reshape(-1))
            factor, trial = factor.reshape(-1), trial.reshape(-1)
        action = _entry(tensordict, self.tensor_keys.action)
        with self._with_parameters():
            trial_loss = score_sum(self.actor_network, tensordict, action, factor, trial, trials)
        return TensorDict._new_unsafe(
            {"loss_actor": self._reduce(trial_loss), "trial_loss": trial_loss.detach()},
            batch_size=torch.Size([]),
        )

    def advantage(self, tensordict: TensorDictBase) -> Tensor:
        """G_t − b for every frame, in the shape of the data [*batch]."""
        return self._advantage(tensordict, self._mask(tensordict))

    def _advantage(self, tensordict: TensorDictBase, mask: Tensor | None) -> Tensor:
        after = _entry(tensordict, "next")
        reward = _entry(after, self.tensor_keys.reward).detach().squeeze(-1)
        done = _entry(after, self.tensor_keys.done).squeeze(-1)
        # A trial may break off before done; the next trial is not its future.
        trial = tensordict.get(self.tensor_keys.trial, None)
        if trial is not None and reward.ndim > 1:
            done = done.clone()
            done[..., :-1] |= trial[..., 1:] != trial[..., :-1]
            trial = None
        if mask is not None:
            reward = torch.where(mask, reward, 0.0)
            done = done | ~mask
        returns = return_to_go(reward, done, self.gamma, trial)
        return returns.sub_(self.baseline) if self.baseline else returns

    def _with_parameters(self) -> contextlib.AbstractContextManager[object]:
        if self.functional:
            return self.actor_network_params.to_module(self.actor_network)
        return contextlib.nullcontext()

    def _trial(self, tensordict: TensorDictBase, advantage: Tensor) -> tuple[Tensor, int]:
        """The trial of every frame [*batch], and the number of trials."""
        trial = tensordict.get(self.tensor_keys.trial, None)
        if trial is None:
            rows = advantage.shape[:-1]
            trial = torch.arange(rows.numel(), device=advantage.device).reshape(*rows, 1)
            trial = trial.expand(advantage.shape)
        if self.trials is not None:
            return trial, self.trials
        return trial, int(trial.max()) + 1 if trial.numel() else 0

    def _mask(self, tensordict: TensorDictBase) -> Tensor | None:
        """Which frames are valid [*batch], where TorchRL has marked them (``loss_mask_key``)."""
        masks = [tensordict.get(key, None) for key in self._loss_mask_keys()]
        found = [mask for mask in masks if mask is not None]
        if not found:
            return None
        shape = tensordict.get(("next", self.tensor_keys.done)).shape[:-1]
        return torch.stack([mask.reshape(shape) for mask in found]).all(0)

    def _reduce(self, trial_loss: Tensor) -> Tensor:
        if self.reduction == "sum":
            return trial_loss.sum()
        return trial_loss.mean() if self.reduction == "mean" else trial_loss


def _entry(tensordict: TensorDictBase, key: NestedKey) -> Any:
    value = tensordict.get(key, None)
    if value is None:
        raise KeyError(f"the data have no entry {key!r}")
    return value
