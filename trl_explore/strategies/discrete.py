"""Strategies over n actions: the base class, and sampling by inverse CDF."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, Unpack, cast

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import dispatch
from torch import Tensor
from torch._C._functorch import is_batchedtensor
from torchrl.data import Categorical, MultiCategorical, MultiOneHot, OneHot, TensorSpec

from trl_explore.strategies.frames import read
from trl_explore.strategies.strategy import BELOW_ONE, BaseStrategy, Keys, exploring


class Options(Keys, total=False):
    """The arguments of ``Strategy``, which every strategy over n actions takes too."""

    spec: TensorSpec | None
    logits_key: NestedKey
    action_mask_key: NestedKey | None
    validate_args: bool


class Strategy(BaseStrategy):
    """A behaviour distribution μ(·|s) over n actions, made from the logits of a target policy.

    A subclass defines ``probs(logits)``. The action is drawn by inverse CDF from one uniform number
    u in [0, 1) per frame:

        a = min{k : Σ_{j ≤ k} μ(j|s) > u}

    The strategy explores if TorchRL's exploration type is RANDOM or unset. Under any other
    type it takes the first action of largest logit, with log-probability 0.

    Reads "logits" [*batch, n_actions] and, if present, "action_mask" [*batch, n_actions] (bool
    or 0 and 1; False: μ forbids the action). A mask in the spec (``spec.update_mask``, TorchRL's
    ``ActionMask``) is obeyed too.
    Writes "action" ([*batch] int64, or one-hot [*batch, n_actions] under a ``OneHot`` spec) and
    "action_log_prob" [*batch] (nats, under μ; float32 for logits of lower precision).

    Under ``MultiOneHot`` and ``MultiCategorical`` the logits of the heads are joined,
    [*batch, Σ n_h]. Every head draws its own action, and the log-probabilities are added.

    A collector of this package also calls ``bind`` once and ``begin`` before every episode.

    Args:
        spec: the action spec (``Categorical``, ``OneHot``, ``MultiCategorical`` or ``MultiOneHot``,
            possibly in a ``Composite``); None: actions are indices.
        logits_key: the entry with the preferences.
        action_mask_key: the entry with the mask; None: "action_mask" in the group of the action.
        validate_args: whether to check that every state has an allowed action with a finite logit.
            In compiled code and on a GPU the check is ``torch._assert_async``.
        keys: ``action_key``, ``log_prob_key``, ``noise_key`` ([*batch], or [*batch, heads]) and
            ``trial_key``, as in ``BaseStrategy``.

    Raises:
        ValueError: if the spec is of another kind, or a state has no action to draw.
    """

    actions = "discrete"
    _index: Tensor

    def __init__(
        self,
        *,
        spec: TensorSpec | None = None,
        logits_key: NestedKey = "logits",
        action_mask_key: NestedKey | None = None,
        validate_args: bool = True,
        **keys: Unpack[Keys],
    ) -> None:
        super().__init__([logits_key], **keys)
        self.logits_key, self.validate_args = logits_key, validate_args
        self.action_mask_key = action_mask_key or self._beside("action_mask")
        self.spec = None if spec is None else self._leaf(spec)
        self.heads = _heads(self.spec)
        self.joint = isinstance(self.spec, MultiOneHot | MultiCategorical)
        if self.joint:
            width, total = max(self.heads), sum(self.heads)
            index = torch.full((len(self.heads), width), total)
            for head, part in zip(index, torch.arange(total).split(self.heads), strict=True):
                head[: len(part)] = part
            self.register_buffer("_index", index, persistent=False)

    @abstractmethod
    def probs(self, logits: Tensor, trial: Tensor | None = None) -> Tensor:
        """μ(·|s) [*batch, n_actions] in the current iteration; 0 for an action of logit −∞.

        ``trial`` [*batch] int64 is needed only if parameters differ between trials.
        """
        raise NotImplementedError(f"{type(self).__name__} does not define probs")

    @dispatch(auto_batch_size=False)
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Draw "action" from μ and write "action_log_prob"."""
        logits = self._masked(tensordict, read(tensordict, self.logits_key))
        n_actions = logits.shape[-1]
        if exploring():
            batch = logits.shape[:-1]
            if self.joint:
                batch = torch.Size((*batch, len(self.heads)))
            noise = self._noise(tensordict, batch, logits.device)
            if self.noise_key is None:  # the layout may change the last bits of μ
                logits = actions_outermost(logits)
            action, log_prob = self.explore(tensordict, logits, noise)
        else:
            logits = self._split(logits)
            action = logits.argmax(-1)
            largest = logits.gather(-1, action.unsqueeze(-1)).squeeze(-1)
            self._check(largest, -torch.inf, logits, tensordict)
            log_prob = torch.zeros_like(largest)
        tensordict.set(self.action_key, self._encode(action, n_actions))
        if log_prob is not None and self.exact:
            if self.joint:
                log_prob = log_prob.sum(-1)
            tensordict.set(self.log_prob_key, log_prob)
        return tensordict

    def _masked(self, tensordict: TensorDictBase, logits: Tensor) -> Tensor:
        """The logits in float32 or float64, −∞ where a mask forbids the action.

        Raises:
            ValueError: if the logits do not fit the spec, or a mask does not fit the logits.
        """
        if not logits.ndim:
            raise ValueError(f"{self.logits_key!r} is one number, not one per action")
        if self.heads and logits.shape[-1] != sum(self.heads):
            raise ValueError(
                f"{self.logits_key!r} has {logits.shape[-1]} entries per frame, "
                f"but the action spec has {sum(self.heads)} actions"
            )
        if logits.dtype not in (torch.float32, torch.float64):  # too coarse for probabilities
            logits = logits.float()
        mask = tensordict.get(self.action_mask_key, None)
        if mask is not None:
            if mask.shape != logits.shape:
                raise ValueError(
                    f"{self.action_mask_key!r} is {list(mask.shape)}, but the logits are "
                    f"{list(logits.shape)}"
                )
            logits = torch.where(mask.bool(), logits, -torch.inf)
        mask = getattr(self.spec, "mask", None)
        if mask is not None:
            logits = torch.where(mask.to(logits.device).expand(logits.shape), logits, -torch.inf)
        return logits

    def _split(self, logits: Tensor) -> Tensor:
        """The logits of the heads [*batch, heads, n], padded with −∞; of one head as they are."""
        if not self.joint:
            return logits
        return torch.nn.functional.pad(logits, (0, 1), value=-torch.inf)[..., self._index]

    def preferences(self, tensordict: TensorDictBase, logits: Tensor) -> Tensor:
        """The input of ``probs``: by default, the logits, −∞ where a mask forbids the action."""
        return logits

    def explore(
        self, tensordict: TensorDictBase, logits: Tensor, noise: Tensor
    ) -> tuple[Tensor, Tensor | None]:
        """The action [*batch] and its log-probability [*batch], None if there is no exact one.

        ``logits`` are masked; ``noise`` is [*batch], or [*batch, noise_size].
        """
        logits = self._split(self.preferences(tensordict, logits))
        probs = self.probs(logits, self._trial(tensordict))
        action, probability = self._draw(probs, noise, logits, tensordict)
        return action, probability.log()

    def _draw(
        self, probs: Tensor, noise: Tensor, logits: Tensor, tensordict: TensorDictBase
    ) -> tuple[Tensor, Tensor]:
        """The action by inverse CDF, checked, and its probability, both [*batch]."""
        dim = -1
        if probs.stride(-1) != 1:  # see ``actions_outermost``
            probs, dim = probs.movedim(-1, 0), 0
        cdf = probs.cumsum(dim, dtype=torch.float64)
        total = cdf.select(dim, -1)
        sound = self._check(total, 0.0, logits, tensordict)
        point = (noise * total).unsqueeze(dim)
        if sound and dim == -1:
            action = torch.searchsorted(cdf, point.contiguous(), right=True)
        else:
            action = (cdf <= point).sum(dim, keepdim=True)  # 0 for NaN
        return action.squeeze(dim), probs.gather(dim, action).squeeze(dim)

    def _check(self, found: Tensor, low: float, logits: Tensor, tensordict: TensorDictBase) -> bool:
        """Refuse a state without an action to draw, whose ``found`` is not above ``low``.

        Returns:
            Whether ``found`` was read, and is above ``low`` in all states.
        """
        if not self.validate_args or not found.numel():
            return False
        if torch.compiler.is_compiling() or not found.is_cpu:
            message = "a state has no allowed action with a finite logit"
            cast(Any, torch)._assert_async((found > low).all(), message)
            return False
        if is_batchedtensor(found) or found.min().item() > low:
            return not is_batchedtensor(found)
        bad = ~(found.reshape(logits.shape[:-1]) > low) & ~logits.isnan().any(-1)
        mask = tensordict.get(self.action_mask_key, None)
        if mask is not None and not mask.bool().any(-1).all():
            raise ValueError("the action mask forbids every action of a state")
        # Our trainer stops a trial that diverges, and goes on with the others.
        if bad.any() and not self._trained_here:
            raise ValueError(
                f"a state has no allowed action with a finite logit: in {self.logits_key!r} "
                "every action that the mask allows has -inf, or one has inf"
            )
        return False

    def log_prob(self, tensordict: TensorDictBase, action: Tensor) -> Tensor:
        """Log μ(a|s) [*batch] in the current iteration.

        The action is in the form that the strategy writes; without a spec also one-hot.
        """
        probs, index = self.probs_of(tensordict), self.index(action)
        if self.spec is None and index.shape == probs.shape:
            index = index.argmax(-1)
        log_prob = probs.gather(-1, index.unsqueeze(-1)).squeeze(-1).log()
        return log_prob.sum(-1) if self.joint else log_prob

    def probs_of(self, tensordict: TensorDictBase) -> Tensor:
        """μ(·|s) of frames: [*batch, n_actions], or [*batch, heads, n] with zeros as padding."""
        logits = self._masked(tensordict, read(tensordict, self.logits_key))
        logits = self._split(self.preferences(tensordict, logits))
        return self.probs(logits, self._trial(tensordict))

    def index(self, action: Tensor) -> Tensor:
        """The indices of actions in the form of the spec: [*batch], or [*batch, heads]."""
        if not isinstance(self.spec, OneHot):
            return action.long()
        parts = action.int().split(self.heads, -1)
        found = torch.stack([part.argmax(-1) for part in parts], -1)
        return found if self.joint else found.squeeze(-1)

    def _encode(self, action: Tensor, n_actions: int) -> Tensor:
        """The action in the form of the spec."""
        if self.spec is None:
            return action
        if isinstance(self.spec, OneHot):
            if self.joint:
                hot = action.unsqueeze(-1) == torch.arange(max(self.heads), device=action.device)
                action = hot.flatten(-2)[..., self._index.flatten() < n_actions]
            else:
                action = action.unsqueeze(-1) == torch.arange(n_actions, device=action.device)
        return action if action.dtype is self.spec.dtype else action.to(self.spec.dtype)


def _heads(spec: TensorSpec | None) -> list[int]:
    """The number of actions of each head of a spec; [] without a spec.

    Raises:
        ValueError: if the spec is of another kind.
    """
    if spec is None:
        return []
    if type(spec) in (Categorical, OneHot):
        return [int(cast(Any, spec.space).n)]
    if isinstance(spec, MultiOneHot):
        return [int(box.n) for box in cast(Any, spec.space)]
    if isinstance(spec, MultiCategorical):
        sizes = spec.nvec.reshape(-1, spec.nvec.shape[-1])
        if bool((sizes == sizes[0]).all()):
            return sizes[0].tolist()
    raise ValueError(
        "the action spec must be Categorical, OneHot, MultiCategorical or MultiOneHot, "
        f"got {type(spec).__name__}"
    )


def inverse_cdf(probs: Tensor, noise: Tensor) -> Tensor:
    """The action a = min{k : Σ_{j ≤ k} p_j > u · Σ_j p_j} [*batch] for u = ``noise`` [*batch].

    Sums are in float64. Rounding never selects an action of probability 0: u is kept so far below 1
    that u times the computed sum is below the sum.

    Example:
        >>> inverse_cdf(torch.tensor([0.25, 0.0, 0.75]), torch.tensor(0.25))
        tensor(2)
    """
    cdf = probs.cumsum(-1, dtype=torch.float64)
    point = noise.double().clamp(max=BELOW_ONE) * cdf[..., -1]
    return (cdf <= point.unsqueeze(-1)).sum(-1)


def actions_outermost(logits: Tensor) -> Tensor:
    """Many logits of few actions, laid out so that torch works on many frames at a time."""
    few = logits.shape[-1] <= 8 and logits.numel() > 1000 and logits.stride(-1) == 1
    if torch.compiler.is_compiling() or not few:
        return logits
    return logits.movedim(-1, 0).contiguous().movedim(0, -1)
