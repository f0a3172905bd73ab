"""The REINFORCE loss."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, cast

import numpy as np
import torch
from tensordict import NestedKey, TensorDict, TensorDictBase, TensorDictParams
from tensordict.nn import ProbabilisticTensorDictSequential, dispatch
from torch import Tensor
from torchrl.modules import ProbabilisticActor
from torchrl.objectives.common import LossModule

from trl_explore.checks import check_flag, check_integer, check_number, settle
from trl_explore.numerics.score import (
    formula_serves,
    linear_softmax_gradient,
    linear_softmax_reinforce,
    linear_softmax_score,
)
from trl_explore.objectives.baselines import Baseline, Constant, as_baseline
from trl_explore.objectives.corrections import Correction, NoCorrection, log_ratio_of
from trl_explore.objectives.episodes import Episodes, entry, read_episodes
from trl_explore.policies import LinearPolicy
from trl_explore.policies.actor import (
    GaussianActor,
    frame_distribution,
    has_linear_softmax,
    is_softmax,
    score_sum,
)
from trl_explore.strategies import BaseStrategy

REDUCTIONS = ("sum", "mean", "none")
EPS = 1e-8
"""Added to the standard deviation when advantages are normalised."""


class ReinforceLoss(LossModule):
    """REINFORCE with reward-to-go, one loss per trial, no critic by default.

    L_k = −w · Σ_{t ∈ frames of trial k} A_t · log π(a_t | s_t),   A_t = G_t − b_t,
    G_t = Σ_{j ≥ t} γ^{j−t} r_j, to the end of the episode

    (Williams 1992; Sutton & Barto, §13.3; thesis, §2.1 and appendix A.3). Without a correction, the
    gradient is that of the expected return only if the data are on-policy (μ = π) and γ = 1 or
    ``discount_steps``. A correction changes A_t or replaces π by μ (``corrections``). Adam cancels
    a constant factor such as w, apart from its ε = 1e-8.

    An episode ends where "done" is true. *Terminated*, *truncated* and cut-off episodes are treated
    alike: the return ends with the last reward, without bootstrapping. Data have one of two
    layouts:

    * flat [frames], the episodes of one or more trials one after another ("trial" is the trial of
      each frame; without it, all frames belong to one trial);
    * [batch, time] as TorchRL's collectors deliver it (without "trial", every row is a trial).
      Frames that TorchRL marks as padding, in ("collector", "mask"), are ignored.

    Reads the actor's inputs, "action", ("next", "reward") and ("next", "done") [*batch, 1], "trial"
    [*batch] int64 and, if a correction needs it, "action_log_prob" [*batch]. Returns "loss_actor"
    (reduced) and "trial_loss" [trials], the same losses before reduction, detached; with a learned
    baseline also "loss_value" (reduced). After the update, ``step`` updates the baseline with the
    same data.

    Args:
        actor_network: the target policy π, any ``ProbabilisticActor``.

    Keyword Args:
        gamma: discount γ in [0, 1].
        weight: w > 0; the thesis multiplies the loss by the learning rate (appendix A.3).
        correction: the off-policy correction for μ ≠ π; None: no correction (the thesis).
        baseline: b, a number (0 in the thesis) or one of ``baselines``.
        discount_steps: whether A_t is multiplied by γ^t; without it, at γ < 1 the gradient is not
            the gradient of any objective (Sutton & Barto, §13.3; Nota & Thomas 2020).
        normalize_advantage: whether each trial's A_t of an iteration (the returns, without baseline
            and correction) are scaled to mean 0 and standard deviation 1. Biased.
        entropy_coeff: c >= 0; adds −w · c · Σ_t H(π(·|s_t)) to L_k (Williams & Peng 1991); with
            ``correction=behaviour``, the entropy of μ.
        strategy: the strategy that collects the data, with the present parameters and in the
            present iteration; some corrections need it or reject it. Where it is the target policy
            by construction (softmax at T = 1), importance weights are exactly 1.
        trials: the number of trials; None: the largest "trial" in the data plus one.
        reduction: reduction over the trials' losses: "sum", "mean" or "none".
        functional: as in TorchRL: whether the parameters are copied into the loss's own container.

    Raises:
        ValueError: if a number is out of range, the reduction is unknown, or the correction does
            not support the strategy.
        KeyError: if the data miss an entry.

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
        sample_log_prob: NestedKey = "action_log_prob"

    tensor_keys: _AcceptedKeys
    default_keys = _AcceptedKeys
    out_keys = ["loss_actor", "trial_loss"]  # noqa: RUF012  # pyright: ignore
    closed_form: ClassVar[bool] = True
    """Whether ``backward`` may use a closed form instead of ``forward`` and autograd. False in a
    class that overrides ``forward``, unless the class declares it."""

    actor_network: ProbabilisticTensorDictSequential
    actor_network_params: TensorDictParams
    target_actor_network_params: TensorDictParams

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        settle(cls, "closed_form", False, ["forward"])

    def __init__(
        self,
        actor_network: ProbabilisticTensorDictSequential,
        *,
        gamma: float = 0.99,
        weight: float = 0.05,
        correction: Correction | None = None,
        baseline: Baseline | float = 0.0,
        discount_steps: bool = False,
        normalize_advantage: bool = False,
        entropy_coeff: float = 0.0,
        strategy: BaseStrategy | None = None,
        trials: int | None = None,
        reduction: str = "sum",
        functional: bool = True,
    ) -> None:
        super().__init__()
        self._functional = functional
        self._in_keys = None
        self.gamma = check_number("gamma", gamma, 0, 1)
        self.weight = check_number("weight", weight, 0, low_open=True)
        self.baseline = as_baseline(baseline)
        self.correction = correction or NoCorrection()
        self.discount_steps = check_flag("discount_steps", discount_steps)
        self.normalize_advantage = check_flag("normalize_advantage", normalize_advantage)
        self.entropy_coeff = check_number("entropy_coeff", entropy_coeff, 0)
        actor_network = self.correction.actor(cast(ProbabilisticActor, actor_network), strategy)
        known = isinstance(actor_network, GaussianActor) or is_softmax(actor_network)
        # A function, so that the strategy does not become a part of the loss's state.
        self._on_policy = _never
        if strategy is not None and known:
            self._on_policy = partial(self.correction.on_policy, strategy)
        self.trials = None if trials is None else check_integer("trials", trials, 1)
        if reduction not in REDUCTIONS:
            raise ValueError(f"reduction must be one of {', '.join(REDUCTIONS)}, got {reduction!r}")
        self.reduction = reduction
        self._weight_key = linear_weight_key(actor_network)
        apart = self.entropy_coeff > 0 or reduction == "mean"
        self._has_closed_form = self.closed_form and self._weight_key is not None and not apart
        if functional:
            self.convert_to_functional(actor_network, "actor_network", create_target_params=False)
        else:
            self.actor_network = actor_network

    @property
    def functional(self) -> bool:
        """Whether the loss holds its own container of the parameters."""
        return self._functional

    @property
    def in_keys(self) -> list[NestedKey]:
        """The entries that a call without a TensorDict takes as keyword arguments."""
        if self._in_keys is None:
            keys = self.tensor_keys
            own = [keys.action, ("next", keys.reward), ("next", keys.done), keys.trial]
            if self.correction.needs_log_prob:
                own.append(keys.sample_log_prob)
            actors = [key for key in self.actor_network.in_keys if key not in own]
            self._in_keys = [*own, *actors]
        return self._in_keys

    @in_keys.setter
    def in_keys(self, values: list[NestedKey]) -> None:
        self._in_keys = values

    def _forward_value_estimator_keys(self, **kwargs: NestedKey) -> None:
        self._in_keys = None

    @dispatch  # pyright: ignore[reportArgumentType] - also a decorator
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The losses of a batch of episodes."""
        episodes, _ = self._episodes(tensordict)
        frames, trial, trials = episodes.tensordict, episodes.trial, episodes.trials
        action = entry(frames, self.tensor_keys.action)
        with self._with_parameters():
            factor = self._factor(episodes, action)
            weight = self._linear_weight(episodes)
            if weight is None:
                score = score_sum(self.actor_network, frames, action, factor, trial, trials)
            else:
                observation = frames.get("observation")
                score = linear_softmax_score(observation, weight, action, factor, trial)
            trial_loss = score * -self.weight
            if self.entropy_coeff:
                entropy: Tensor = frame_distribution(self.actor_network, frames).entropy()
                bonus = episodes.by_trial(entropy.reshape(-1))
                trial_loss = trial_loss - self.weight * self.entropy_coeff * bonus
        out = {"loss_actor": self._reduce(trial_loss), "trial_loss": trial_loss.detach()}
        value_loss = self.baseline.loss(episodes)
        if value_loss is not None:
            out["loss_value"] = self._reduce(value_loss)
        return TensorDict._new_unsafe(out, batch_size=torch.Size([]))

    def backward(self, tensordict: TensorDictBase) -> Tensor:
        """Accumulate the gradient of the sum of all losses, and return "trial_loss".

        If π is the softmax of a linear policy, the gradient has a closed form, which takes a
        fraction of autograd's time and gives the same bits. The choice between the two is made when
        the loss is built, so hooks of the policy are called only if they are registered before
        that. Hooks of its weights are always called.
        """
        found = self._closed_form(tensordict) if self._has_closed_form else None
        if found is not None:
            return found
        losses = self.forward(tensordict)
        total = losses.get("loss_actor").sum()
        value_loss = losses.get("loss_value", None)
        (total if value_loss is None else total + value_loss.sum()).backward()
        return losses.get("trial_loss")

    def _closed_form(self, tensordict: TensorDictBase) -> Tensor | None:
        """``backward`` without a graph; None if the closed form does not apply to these data."""
        episodes, _ = self._episodes(tensordict)
        frames, trial = episodes.tensordict, episodes.trial
        weight = self._linear_weight(episodes)
        if weight is None or not takes_gradient(weight):
            return None
        observation, action = frames.get("observation"), entry(frames, self.tensor_keys.action)
        if not formula_serves(observation, weight, episodes.reward):
            return None
        found, scale, baseline = None, -self.weight, self.baseline
        if type(baseline) is Constant and self._is_return_alone():
            found = linear_softmax_reinforce(
                observation, weight, action, episodes.reward, episodes.done, trial,
                gamma=self.gamma, baseline=baseline.value, scale=scale,
            )  # fmt: skip
        if found is None:
            with self._with_parameters():
                factor = self._factor(episodes, action)
            if not formula_serves(observation, weight, factor):
                return None
            found = linear_softmax_gradient(observation, weight, action, factor, trial, scale)
        trial_loss, gradient = found
        weight.grad = gradient if weight.grad is None else weight.grad.add_(gradient)
        value_loss = baseline.loss(episodes)
        if value_loss is not None:
            value_loss.sum().backward()
        return trial_loss

    def _linear_weight(self, episodes: Episodes) -> Tensor | None:
        """W [trials, n_actions, n_features] of a linear softmax; None if a mask changes π."""
        if self._weight_key is None or "action_mask" in episodes.tensordict:
            return None
        if self.functional:
            weight = self.actor_network_params.get(self._weight_key)
        else:
            weight = cast(LinearPolicy, self.actor_network[0]).weight
        return weight if len(weight) == episodes.trials else None

    def _is_return_alone(self) -> bool:
        """Whether the factor of ∇log π is exactly the return minus the baseline."""
        more = self.discount_steps or self.normalize_advantage
        return self.correction.leaves_returns and not more

    def advantage(self, tensordict: TensorDictBase) -> Tensor:
        """The factor of ∇log π(a_t|s_t) for every frame, in the shape of the data [*batch].

        G_t − b_t without a correction; 0 for padding.
        """
        episodes, mask = self._episodes(tensordict)
        action = entry(episodes.tensordict, self.tensor_keys.action)
        with self._with_parameters():
            flat = self._factor(episodes, action)
        if mask is None:
            return flat.reshape(tensordict.shape)
        out = flat.new_zeros(tensordict.shape)
        out[mask] = flat
        return out

    def step(self, tensordict: TensorDictBase) -> None:
        """Update the baseline with an iteration's data; call once, after the update."""
        if self.baseline.learns_from_data:
            self.baseline.step(self._episodes(tensordict)[0])

    @torch.no_grad()
    def _factor(self, episodes: Episodes, action: Tensor) -> Tensor:
        """The factor of ∇log π of every frame [frames]."""
        log_ratio = None
        if self.correction.needs_log_prob:
            behaviour = entry(episodes.tensordict, self.tensor_keys.sample_log_prob)
            actor, correction = self.actor_network, self.correction
            numerator = correction.log_numerator(actor, episodes.tensordict, action)
            log_ratio = log_ratio_of(numerator, behaviour.reshape(-1))
            on_policy = torch.as_tensor(self._on_policy(), device=log_ratio.device)
            per_frame = on_policy[episodes.trial] if on_policy.ndim else on_policy
            log_ratio = log_ratio.masked_fill(per_frame, 0.0)  # 1 exactly, not up to rounding
        baseline = self.baseline(episodes)
        factor = self.correction.advantage(episodes, baseline, log_ratio)
        if self.discount_steps:
            factor = factor * _powers(self.gamma, episodes.step).to(factor.dtype)
        if self.normalize_advantage:
            factor = factor - episodes.trial_mean(factor)[episodes.trial]
            variance = episodes.trial_mean(factor**2)[episodes.trial]
            factor = factor / (variance.sqrt() + EPS)
        return factor

    def _episodes(self, tensordict: TensorDictBase) -> tuple[Episodes, Tensor | None]:
        """Flat frames, and the mask [*batch] that selects them from the data; None: all."""
        masks = self._loss_mask_keys()
        return read_episodes(tensordict, self.tensor_keys, masks, self.trials, self.gamma)

    def _with_parameters(self) -> contextlib.AbstractContextManager[object]:
        if self.functional:
            return self.actor_network_params.to_module(self.actor_network)
        return contextlib.nullcontext()

    def _reduce(self, trial_loss: Tensor) -> Tensor:
        if self.reduction == "sum":
            return trial_loss.sum()
        return trial_loss.mean() if self.reduction == "mean" else trial_loss


def _never() -> bool:
    return False


def _powers(gamma: float, exponent: Tensor) -> Tensor:
    """γ^k of each k in ``exponent`` [n], as products in a fixed order.

    The vectorised power differs in its last bit with the place of a number in the batch.
    """
    count = int(exponent.max()) if exponent.numel() else 0
    table = np.multiply.accumulate(np.array([1.0, *[gamma] * count]))
    return torch.from_numpy(table).to(exponent.device)[exponent]


def linear_weight_key(actor: ProbabilisticTensorDictSequential) -> tuple[str, ...] | None:
    """The key of W among the parameters of a linear softmax; None for any other π."""
    if not has_linear_softmax(actor):
        return None
    weight = cast(LinearPolicy, actor[0]).weight
    names = (tuple(name.split(".")) for name, p in actor.named_parameters() if p is weight)
    return next(names, None)


def takes_gradient(weight: Tensor) -> bool:
    """Whether a gradient may be added to W without autograd, which calls hooks and goes on."""
    hooked = weight._backward_hooks or weight._post_accumulate_grad_hooks
    return weight.requires_grad and weight.is_leaf and not hooked
