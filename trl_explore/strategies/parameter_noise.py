"""Parameter-space noise: one perturbed policy per episode."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torch.func import functional_call

from trl_explore.checks import check_number
from trl_explore.numerics.score import lane_sum
from trl_explore.numerics.streams import Stream, generator
from trl_explore.strategies.mixture import Mixture, MixtureStrategy
from trl_explore.strategies.schedules import Schedule, as_schedule

Parameters = dict[str, Tensor]


class ParameterNoise(MixtureStrategy):
    """Softmax of the target policy's logits under perturbed parameters.

    μ(·|s) = softmax(logits(s; θ̃) / T),   θ̃ = θ + σ ξ,   ξ ~ N(0, I), drawn once per episode

    (Plappert et al. 2018, "Parameter Space Noise for Exploration", §3.) ξ is fixed within an
    episode, and given ξ the probabilities of μ are exact. At T > 0, every action with positive
    probability under π has positive probability under μ.

    With a ``threshold``, σ of each trial adapts to the effect of the noise on the actions. After
    every iteration, with d the mean KL(π‖π̃) in nats over the frames of the trial's last episode,
    between the softmax at T = 1 of the two sets of logits, with the parameters of that episode,

        σ ← factor · σ if d <= threshold, else σ / factor      (§3.1; appendix C.1 for the KL)

    The first dimension of every parameter of the policy is the trial; with a single trial, any
    shape works. Call ``bind`` to set the policy. A collector that does not call ``begin`` must mark
    the first frame of each episode with "is_init" (TorchRL's ``InitTracker``); without it, one
    perturbation is kept throughout.

    Args:
        sigma: σ >= 0, a number, one number per trial, or a schedule of the iteration.
        temperature: T >= 0, in the same forms as ``sigma``; 0 gives argmax.
        threshold: > 0, the target for d; None: σ does not adapt.
        factor: > 1.
        options: the arguments of ``Strategy``.

    Raises:
        ValueError: if an argument is out of range, or a parameter of the policy has another shape.
    """

    compilable = True  # its preferences are the logits of ``behaviour_parameters``

    def __init__(
        self,
        sigma: float | Sequence[float] | Schedule = 0.1,
        temperature: float | Sequence[float] | Schedule = 1.0,
        threshold: float | None = 0.1,
        factor: float = 1.01,
        **options: Any,
    ) -> None:
        super().__init__(**options)
        self.sigma = as_schedule("sigma", sigma, 0, float("inf"))
        self.temperature = as_schedule("temperature", temperature, 0, float("inf"))
        self.threshold = threshold
        if threshold is not None:
            self.threshold = check_number("threshold", threshold, 0, low_open=True)
        self.factor = check_number("factor", factor, 1, low_open=True)
        self.scale: NDArray[np.float64] = np.ones(1)
        """The factor that adaptation applies to σ, for each trial [trials]."""
        self._policy: tuple[TensorDictModuleBase, ...] = ()  # a tuple: not a submodule
        self._whom = (0, 0)  # seed, first trial
        self._forget(1)

    def _forget(self, trials: int) -> None:
        self._episodes = np.full(trials, -1, dtype=np.int64)
        self._noise_of = np.zeros((trials, 0))
        self._fresh = np.zeros(trials, dtype=np.bool_)
        self._center: Parameters = {}
        self._perturbed: Parameters = {}

    def bind(
        self, policy: TensorDictModuleBase, trials: int, *, seed: int = 0, first_trial: int = 0
    ) -> None:
        """Set the policy whose parameters are perturbed."""
        super().bind(policy, trials, seed=seed, first_trial=first_trial)
        for name, parameter in policy.named_parameters():
            if trials > 1 and (parameter.ndim == 0 or len(parameter) != trials):
                raise ValueError(
                    f"the first dimension of every parameter must be the {trials} trials, "
                    f"got {name} of shape {list(parameter.shape)}"
                )
        self._policy, self._whom = (policy,), (seed, first_trial)
        self.scale = np.ones(trials)
        self._forget(trials)

    def mixture(self) -> Mixture:
        """Softmax of ``preferences``."""
        return Mixture(softmax=1.0, temperature=self.temperature(self.iteration))

    def begin(self, active: NDArray[np.bool_], episodes: NDArray[np.int64]) -> None:
        """Perturb the parameters of the active trials for one episode."""
        if not self._policy:
            raise ValueError("parameter noise has no policy: call bind(policy, trials) first")
        own = {name: p.detach() for name, p in self._policy[0].named_parameters()}
        trials = len(self.scale)
        size = sum(p.numel() for p in own.values()) // trials
        if self._noise_of.shape[1] != size:
            self._noise_of = np.zeros((trials, size))
        seed, first_trial = self._whom
        for k in np.flatnonzero(active).tolist():
            stream = generator(seed, Stream.STRATEGY, first_trial + k, int(episodes[k]))
            self._noise_of[k] = stream.standard_normal(size)
        self._episodes[active] = episodes[active]
        self._fresh[active] = True
        noise = torch.from_numpy(self._noise_of * self._sigma()[:, None])
        if not self._center:
            self._center = {name: p.clone() for name, p in own.items()}
        rows, start = torch.from_numpy(active), 0
        for name, parameter in own.items():
            n = parameter.numel() // trials
            shift = noise[:, start : start + n].to(parameter.dtype).reshape(parameter.shape)
            start += n
            if trials == 1:
                self._center[name] = parameter.clone()
            else:
                self._center[name][rows] = parameter[rows]
            self._perturbed[name] = self._center[name] + shift

    def _sigma(self) -> NDArray[np.float64]:
        """σ of each trial in the current iteration [trials]."""
        return self.scale * self.sigma(self.iteration)

    def preferences(self, tensordict: TensorDictBase, logits: Tensor) -> Tensor:
        """The logits of the perturbed policy."""
        first = tensordict.get("is_init", None)
        if not self._perturbed:
            self.begin(np.ones(len(self.scale), dtype=np.bool_), self._episodes.clip(0))
        elif first is not None:
            self._begin_again(tensordict, first)
        self._fresh[:] = False
        return self._logits(self._perturbed, tensordict).masked_fill(
            logits == -torch.inf, -torch.inf
        )

    def _begin_again(self, tensordict: TensorDictBase, first: Tensor) -> None:
        """Begin the next episode of trials at a first frame, unless it has just begun."""
        trial = tensordict.get("trial", None)
        starts = np.zeros(len(self.scale), dtype=np.bool_)
        first = first.reshape(-1)
        starts[0 if trial is None else trial.reshape(-1)[first].numpy()] = bool(first.any())
        starts &= ~self._fresh
        if starts.any():
            self.begin(starts, self._episodes + 1)

    def _logits(self, parameters: Parameters, tensordict: TensorDictBase) -> Tensor:
        policy = self._policy[0]
        given = tensordict.select(*policy.in_keys, strict=False)
        with torch.no_grad():
            return functional_call(policy, parameters, (given,)).get(self.logits_key)

    def behaviour_parameters(self, parameters: Sequence[Tensor]) -> list[Tensor]:
        """The perturbed parameters."""
        names = {id(parameter): name for name, parameter in self._policy[0].named_parameters()}
        return [self._perturbed[names[id(parameter)]] for parameter in parameters]

    def step(self, data: TensorDictBase | None = None) -> None:
        """Adapt σ."""
        super().step(data)
        if data is None or self.threshold is None or not self._perturbed:
            return
        data = _last_episodes(data)
        distance, frames = self._distance(data)
        grow = np.where(distance <= self.threshold, self.factor, 1 / self.factor)
        self.scale = np.where(frames > 0, self.scale * grow, self.scale)

    def _distance(self, data: TensorDictBase) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Mean KL(π‖π̃) over the frames of each trial, and their number, both [trials]."""
        trials = len(self.scale)
        own, other = (self._logits(p, data) for p in (self._center, self._perturbed))
        if (mask := data.get(self.action_mask_key, None)) is not None:
            own, other = own.masked_fill(~mask, -torch.inf), other.masked_fill(~mask, -torch.inf)
        own, other = own.double().log_softmax(-1), other.double().log_softmax(-1)
        terms = torch.where(own == -torch.inf, 0.0, own.exp() * (own - other))
        trial = data.get("trial", None)
        if trial is None:
            trial = torch.zeros(len(data), dtype=torch.int64)
        frames = torch.bincount(trial, minlength=trials)
        total = lane_sum(terms.sum(-1), trial, trials)
        return (total / frames.clamp(min=1)).numpy(), frames.numpy()

    def get_extra_state(self) -> dict[str, Any]:
        """The state for ``state_dict``; perturbations are redrawn from their streams."""
        adapted = {"scale": torch.tensor(self.scale), "episodes": torch.tensor(self._episodes)}
        return {**super().get_extra_state(), **adapted}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore the state from ``get_extra_state``."""
        super().set_extra_state(state)
        self._forget(len(state["scale"]))
        self.scale, self._episodes = state["scale"].numpy().copy(), state["episodes"].numpy().copy()


def _last_episodes(data: TensorDictBase) -> TensorDictBase:
    """The frames of every trial's last episode, flat [frames]."""
    data = data.reshape(-1)
    trial = data.get("trial", None)
    if trial is None:
        trial = torch.zeros(len(data), dtype=torch.int64)
    done = data.get(("next", "done")).reshape(-1)
    ended = done.cumsum(0) - done.long()  # episodes that ended before the frame
    last = ended.new_zeros(int(trial.max()) + 1).scatter_reduce(0, trial, ended, "amax")
    return data[ended == last[trial]]
