"""The REINFORCE loss."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, cast

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase, TensorDictParams
from tensordict.nn import ProbabilisticTensorDictSequential, dispatch
from torch import Tensor
from torchrl.modules import ProbabilisticActor
from torchrl.objectives.common import LossModule

from trl_explore.checks import check_flag, check_integer, check_number, settle
from trl_explore.numerics.surrogate import linear_softmax_surrogate
from trl_explore.objectives.baselines import Baseline, Constant, as_baseline
from trl_explore.objectives.corrections import Correction, NoCorrection, log_ratio_of
from trl_explore.objectives.episodes import Episodes
from trl_explore.objectives.linear_softmax import closed_form, linear_weight_key
from trl_explore.objectives.reading import read_episodes
from trl_explore.policies import LinearPolicy
from trl_explore.policies.actor import (
    GaussianActor,
    fitted,
    frame_entropy,
    frame_log_prob,
    is_softmax,
)
from trl_explore.strategies import BaseStrategy
from trl_explore.strategies.frames import read

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

    An episode ends where "done" is true, and where ("collector", "traj_ids") changes. *Terminated*,
    *truncated* and cut-off episodes are treated alike: the return ends with the last reward,
    without bootstrapping. Data have one of two layouts:

    * flat [frames], the episodes of one or more trials one after another ("trial" is the trial of
      each frame; without it, all frames belong to one trial);
    * [*rows, time] as TorchRL's collectors deliver it (without "trial", every row is a trial; with
      ``trials=1``, all rows are one). Frames that TorchRL marks as padding, in ("collector",
      "mask"), are ignored.

    Reads the actor's inputs, "action" (indices or one-hot for a categorical π), ("next", "reward")
    and ("next", "done") [*batch, 1], "trial" [*batch] int64 and, if a correction needs it,
    "action_log_prob" [*batch]; ``set_keys`` renames them. If the reward of a group of agents, such
    as ("agents", "reward"), is [*batch, agents, 1], every agent has its own returns and baseline,
    and L_k is the sum over the agents; one reward for all belongs to their joint action.

    Returns "loss_actor" (reduced) and "trial_loss" [trials], the same losses before reduction,
    detached; with a learned baseline also "loss_value" (reduced). After the update, ``step``
    updates the baseline with the same data.

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
        trials: the number of trials; None: the largest "trial" in the data plus one, or the rows.
        reduction: reduction over the trials' losses: "sum", "mean" or "none".
        functional: as in TorchRL: whether the parameters are copied into the loss's own container.

    Raises:
        ValueError: if an argument is out of range or of another kind, the correction does not
            support the strategy, or an entry of the data does not fit.
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
        traj_ids: NestedKey = ("collector", "traj_ids")

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
        self.correction = _checked(actor_network, correction or NoCorrection())
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
        self._mask_key = actor_network.action_mask_key if is_softmax(actor_network) else None
        apart = self.entropy_coeff > 0 or reduction == "mean"
        self._has_closed_form = self.closed_form and self._weight_key is not None and not apart
        plain = self.correction.leaves_returns and not (discount_steps or normalize_advantage)
        fixed = self.baseline.value if isinstance(self.baseline, Constant) else None
        self._constant: float | None = fixed if plain else None  # if A_t is exactly G_t − b
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

    @dispatch(auto_batch_size=False)
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The losses of a batch of episodes."""
        episodes = self._episodes(tensordict)
        frames, action = episodes.tensordict, read(episodes.tensordict, self.tensor_keys.action)
        with self._with_parameters():
            factor = self._factor(episodes, action)
            weight = self._linear_weight(episodes)
            if weight is None:
                log_prob = episodes.flat(frame_log_prob(self.actor_network, frames, action))
                surrogate = episodes.by_trial(log_prob * factor)
            else:
                action = fitted(action, episodes.trial.shape, weight.shape[1])
                observation = frames.get("observation")
                surrogate = linear_softmax_surrogate(
                    observation, weight, action, factor, episodes.trial
                )
            trial_loss = surrogate * -self.weight
            if self.entropy_coeff:
                bonus = episodes.by_trial(episodes.flat(frame_entropy(self.actor_network, frames)))
                trial_loss = trial_loss - self.weight * self.entropy_coeff * bonus
        trial_loss = episodes.over_agents(trial_loss)
        out = {"loss_actor": self._reduce(trial_loss), "trial_loss": trial_loss.detach()}
        value_loss = self.baseline.loss(episodes)
        if value_loss is not None:
            out["loss_value"] = self._reduce(episodes.over_agents(value_loss))
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
        episodes = self._episodes(tensordict)
        weight = self._linear_weight(episodes)
        if weight is None:
            return None
        action = read(episodes.tensordict, self.tensor_keys.action)
        action = fitted(action, episodes.trial.shape, weight.shape[1])

        def factor() -> Tensor:
            with self._with_parameters():
                return self._factor(episodes, action)

        found = closed_form(weight, episodes, action, -self.weight, self._constant, factor)
        if found is None:
            return None
        trial_loss, gradient = found
        weight.grad = gradient if weight.grad is None else weight.grad.add_(gradient)
        value_loss = self.baseline.loss(episodes)
        if value_loss is not None:
            value_loss.sum().backward()
        return trial_loss

    def _linear_weight(self, episodes: Episodes) -> Tensor | None:
        """W [trials, n_actions, n_features] of a linear softmax; None if a mask changes π."""
        if self._weight_key is None or episodes.layout.agents > 1:
            return None
        if self._mask_key in episodes.tensordict:
            return None
        if self.functional:
            weight = self.actor_network_params.get(self._weight_key)
        else:
            weight = cast(LinearPolicy, self.actor_network[0]).weight
        return weight if len(weight) == episodes.trials else None

    def advantage(self, tensordict: TensorDictBase) -> Tensor:
        """The factor of ∇log π(a_t|s_t) for every frame, in the shape of the data.

        G_t − b_t [*batch] without a correction; [*batch, agents] with several rewards; 0 for
        padding.
        """
        episodes = self._episodes(tensordict)
        action = read(episodes.tensordict, self.tensor_keys.action)
        with self._with_parameters():
            return episodes.restore(self._factor(episodes, action))

    def step(self, tensordict: TensorDictBase) -> None:
        """Update the baseline with an iteration's data; call once, after the update."""
        if self.baseline.learns_from_data:
            self.baseline.step(self._episodes(tensordict))

    @torch.no_grad()
    def _factor(self, episodes: Episodes, action: Tensor) -> Tensor:
        """The factor of ∇log π of every frame [frames]."""
        log_ratio = None
        if self.correction.needs_log_prob:
            behaviour = read(episodes.tensordict, self.tensor_keys.sample_log_prob)
            actor, correction = self.actor_network, self.correction
            numerator = correction.log_numerator(actor, episodes.tensordict, action)
            log_ratio = log_ratio_of(episodes.flat(numerator), episodes.flat(behaviour))
            on_policy = torch.as_tensor(self._on_policy(), device=log_ratio.device)
            trial = episodes.trial // episodes.layout.agents
            per_frame = on_policy[trial] if on_policy.ndim else on_policy
            log_ratio = log_ratio.masked_fill(per_frame, 0.0)  # 1 exactly, not up to rounding
        baseline = self.baseline(episodes)
        factor = self.correction.advantage(episodes, baseline, log_ratio)
        if self.discount_steps:
            factor = factor * episodes.discount
        if self.normalize_advantage:
            factor = factor - episodes.trial_mean(factor)[episodes.trial]
            variance = episodes.trial_mean(factor**2)[episodes.trial]
            factor = factor / (variance.sqrt() + EPS)
        return factor

    def _episodes(self, tensordict: TensorDictBase) -> Episodes:
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


def _checked(actor: object, correction: Correction) -> Correction:
    """The correction, if it and the actor are of the right kind."""
    if not hasattr(actor, "get_dist"):
        raise ValueError(
            f"actor_network must be a ProbabilisticActor, got {type(actor).__name__}, "
            "which gives no probability of an action"
        )
    if not isinstance(correction, NoCorrection):
        raise ValueError(f"correction must be an object such as PerStep(), got {correction!r}")
    return correction


def _never() -> bool:
    return False
