"""The REINFORCE loss."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, cast

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase, TensorDictParams
from tensordict.nn import ProbabilisticTensorDictSequential, dispatch
from torch import Tensor
from torchrl.modules import ProbabilisticActor
from torchrl.objectives.common import LossModule

from trl_explore.checks import check_flag, check_integer, check_number, holds, withdraw
from trl_explore.numerics.surrogate import FrameArrays, linear_softmax_surrogate
from trl_explore.objectives.baselines import Baseline, Constant
from trl_explore.objectives.corrections import Correction, as_correction, log_ratio_of
from trl_explore.objectives.episodes import Episodes
from trl_explore.objectives.linear_softmax import (
    closed_form,
    closed_form_of_arrays,
    linear_weight,
    linear_weight_key,
    weight_of,
)
from trl_explore.objectives.reading import Keys, read_episodes
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
EPS = 1e-8  # added to the standard deviation when advantages are normalised


class ReinforceLoss(LossModule):
    """REINFORCE with reward-to-go, one loss per trial, no critic by default.

    L_k = −w · Σ_{t ∈ frames of trial k} A_t · log π(a_t | s_t),   A_t = G_t − b_t,
    G_t = Σ_{j ≥ t} γ^{j−t} r_j, to the end of the episode

    (Williams 1992; Sutton & Barto, §13.3; thesis, §2.1 and appendix A.3). Without a correction, the
    gradient is that of the expected return only if the data are on-policy (μ = π) and γ = 1 or
    ``discount_steps``. A correction changes A_t or replaces π by μ (``corrections``).

    An episode ends where "done" is true, and where ("collector", "traj_ids") changes. *Terminated*,
    *truncated* and cut-off episodes are treated alike: the return ends with the last reward,
    without bootstrapping. Data have one of two layouts:

    * flat [frames], episode after episode, with the "trial" of each frame (without it, one trial);
    * [*rows, time] as TorchRL's collectors deliver it (without "trial", every row is a trial; with
      ``trials=1``, all rows are one). Padding, marked in ("collector", "mask"), is ignored.

    Reads the actor's inputs, "action" (indices or one-hot for a categorical π), ("next", "reward")
    and ("next", "done") [*batch, 1], "trial" [*batch] int64 and, if a correction needs it,
    "action_log_prob" [*batch]; ``set_keys`` renames them. If the reward of a group of agents, such
    as ("agents", "reward"), is [*batch, agents, 1], every agent has its own returns and baseline,
    and L_k is the sum over the agents; one reward for all belongs to their joint action.

    Returns "loss_actor" (reduced) and "trial_loss" [trials] (the same, not reduced, detached); with
    a learned baseline also "loss_value". After the update, ``step`` updates the baseline.

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
        strategy: the strategy that collects the data; some corrections need it or reject it. Where
            it is π by construction (softmax at T = 1), importance weights are exactly 1.
        trials: the number of trials; None: the largest "trial" in the data plus one, or the rows.
        reduction: reduction over the trials' losses: "sum", "mean" or "none".
        functional: as in TorchRL: whether the parameters are copied into the loss's own container.

    Raises:
        ValueError: if an argument or an entry of the data does not fit, or the correction does not
            support the strategy.
        KeyError: if the data miss an entry.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule
        >>> from torch.distributions import Categorical
        >>> logits = TensorDictModule(torch.nn.Linear(4, 2), ["observation"], ["logits"])
        >>> actor = ProbabilisticActor(logits, in_keys=["logits"], distribution_class=Categorical)
        >>> after = {"reward": torch.ones(3, 1), "done": torch.tensor([[False], [False], [True]])}
        >>> data = {"observation": torch.ones(3, 4), "action": torch.zeros(3).long(), "next": after}
        >>> ReinforceLoss(actor)(TensorDict(data, [3]))["loss_actor"].backward()
    """

    _AcceptedKeys = default_keys = Keys  # pyright: ignore[reportAssignmentType]
    tensor_keys: Keys
    out_keys = ["loss_actor", "trial_loss"]  # noqa: RUF012  # pyright: ignore
    closed_form: ClassVar[bool] = True
    """Whether ``backward`` may use a closed form instead of ``forward`` and autograd. False in a
    class that overrides ``forward``, unless the class declares it."""
    arrays_suffice: ClassVar[bool] = True
    """Whether ``array_backward`` alone may do the work of ``backward`` and ``step``. False in a
    class that overrides ``forward`` or a method in ``REPLACED``, unless the class declares it."""
    REPLACED: ClassVar[tuple[str, ...]] = ("backward", "step", "_episodes")

    actor_network: ProbabilisticTensorDictSequential
    actor_network_params: TensorDictParams
    target_actor_network_params: TensorDictParams

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        withdraw(cls, "closed_form", False, ["forward"])
        withdraw(cls, "arrays_suffice", False, ("forward", *cls.REPLACED))

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
        self.baseline = baseline if isinstance(baseline, Baseline) else Constant(baseline)
        if not hasattr(actor_network, "get_dist"):
            raise ValueError(
                f"actor_network must be a ProbabilisticActor, got {type(actor_network).__name__}, "
                "which gives no probability of an action"
            )
        self.correction = as_correction(correction)
        self.discount_steps = check_flag("discount_steps", discount_steps)
        self.normalize_advantage = check_flag("normalize_advantage", normalize_advantage)
        self.entropy_coeff = check_number("entropy_coeff", entropy_coeff, 0)
        actor_network = self.correction.actor(cast(ProbabilisticActor, actor_network), strategy)
        known = isinstance(actor_network, GaussianActor) or is_softmax(actor_network)
        # A function, so that the strategy does not become a part of the loss's state.
        self._on_policy = bool  # gives False
        if strategy is not None and known:
            self._on_policy = partial(self.correction.on_policy, strategy)
        self.trials = None if trials is None else check_integer("trials", trials, 1)
        if reduction not in REDUCTIONS:
            raise ValueError(f"reduction must be one of {', '.join(REDUCTIONS)}, got {reduction!r}")
        self.reduction = reduction
        self._weight_key = linear_weight_key(actor_network)
        apart = self.entropy_coeff > 0 or reduction == "mean"
        self._has_closed_form = self.closed_form and self._weight_key is not None and not apart
        plain = self.correction.leaves_returns and not (discount_steps or normalize_advantage)
        fixed = plain and isinstance(self.baseline, Constant)  # A_t is exactly G_t − b
        self._constant = cast(Constant, self.baseline).value if fixed else None
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
            self._in_keys = list(dict.fromkeys([*own, *self.actor_network.in_keys]))
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
        factor, weight = self._factor(episodes, action), self._linear_weight(episodes)
        with self._with_parameters():
            if weight is None:
                log_prob = episodes.flat(frame_log_prob(self.actor_network, frames, action))
                surrogate = episodes.by_trial(log_prob * factor)
            else:
                action = fitted(action, episodes.trial.shape, weight.shape[1])
                observation, trial = frames.get("observation"), episodes.trial
                surrogate = linear_softmax_surrogate(observation, weight, action, factor, trial)
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

        The softmax of a linear policy has a closed form, with the same bits in a fraction of
        autograd's time, chosen when the loss is built: hooks that the policy gets later are not
        called, but those of its weights always are.
        """
        if self._has_closed_form:
            episodes = self._episodes(tensordict)
            weight = self._linear_weight(episodes)
            trial_loss = None if weight is None else self._closed_form(episodes, weight)
            if trial_loss is not None:
                return trial_loss
        losses = self.forward(tensordict)
        parts = [losses.get(key).sum() for key in ("loss_actor", "loss_value") if key in losses]
        cast(Tensor, sum(parts)).backward()
        return losses.get("trial_loss")

    def array_backward(self) -> Callable[[FrameArrays], Tensor | None] | None:
        """A function that does all that ``backward`` and ``step`` do, from one array per entry.

        It returns "trial_loss", or None if the weights need ``backward``. It keeps the present
        weights: ask for it when the training begins.

        Returns:
            The function, if the policy is a linear softmax, A_t = G_t − b, and the entries have
            their usual names; else None.
        """
        own = self.arrays_suffice and holds(self, "arrays_suffice", self.REPLACED)
        constant, key = self._constant, self._weight_key
        if not (own and self._has_closed_form and self.tensor_keys == self.default_keys()):
            return None
        if constant is None or key is None:
            return None
        parameters = self.actor_network_params if self.functional else None
        weight = weight_of(self.actor_network, parameters, key)
        if weight.shape[0] != self.trials:
            return None
        return lambda frames: closed_form_of_arrays(
            weight, frames, self.gamma, constant, -self.weight
        )

    def _closed_form(self, episodes: Episodes, weight: Tensor) -> Tensor | None:
        """``backward`` without a graph; None if the closed form does not apply to these data."""
        action = read(episodes.tensordict, self.tensor_keys.action)
        factor = partial(self._factor, episodes, action)
        trial_loss = closed_form(weight, episodes, action, -self.weight, self._constant, factor)
        value_loss = None if trial_loss is None else self.baseline.loss(episodes)
        if value_loss is not None:
            value_loss.sum().backward()
        return trial_loss

    def _linear_weight(self, episodes: Episodes) -> Tensor | None:
        """W [trials, n_actions, n_features] of a linear softmax; None if π of the data is none."""
        if self._weight_key is None:
            return None
        parameters = self.actor_network_params if self.functional else None
        return linear_weight(self.actor_network, parameters, self._weight_key, episodes)

    def advantage(self, tensordict: TensorDictBase) -> Tensor:
        """The factor of ∇log π(a_t|s_t) [*batch], or [*batch, agents]; 0 for padding.

        Without a correction, it is G_t − b_t.
        """
        episodes = self._episodes(tensordict)
        action = read(episodes.tensordict, self.tensor_keys.action)
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
            with self._with_parameters():
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
        return trial_loss if self.reduction == "none" else getattr(trial_loss, self.reduction)()
