"""Parameter-space noise: one perturbed policy per episode."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Unpack

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torch.func import functional_call

from trl_explore.checks import check_number
from trl_explore.numerics.layers import lane_sum
from trl_explore.numerics.streams import Stream, generator
from trl_explore.strategies.discrete import Options
from trl_explore.strategies.frames import FirstFrames
from trl_explore.strategies.mixture import Mixture, MixtureStrategy
from trl_explore.strategies.schedules import Parameter

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

    Call ``bind`` to set the policy. A collector of this package calls ``begin``; the first
    dimension of every parameter of the policy is then the trial, and with a single trial any shape
    works. With any other collector every lane of the batch has a perturbation ξ of its own, which
    the first frame of an episode replaces (see ``strategies.frames``), and d is the mean over
    the frames since the last ``step`` that this copy of the strategy has seen.

    Args:
        sigma: σ >= 0, a number, one number per trial, or a schedule.
        temperature: T >= 0, in the same forms as ``sigma``; 0 gives argmax.
        threshold: > 0, the target for d; None: σ does not adapt.
        factor: > 1.
        is_init_key: the entry that marks the first frame of an episode.
        options: the arguments of ``Strategy``.

    Raises:
        ValueError: if an argument is out of range, or a parameter of the policy has another shape.
    """

    compilable = True  # its preferences are the logits of ``behaviour_parameters``
    sigma: Tensor
    temperature: Tensor
    scale: Tensor
    """The factor that adaptation applies to σ, for each trial [trials]."""

    def __init__(
        self,
        sigma: Parameter = 0.1,
        temperature: Parameter = 1.0,
        threshold: float | None = 0.1,
        factor: float = 1.01,
        is_init_key: NestedKey = "is_init",
        **options: Unpack[Options],
    ) -> None:
        super().__init__(**options)
        self.follow("sigma", sigma)
        self.follow("temperature", temperature)
        self.threshold = threshold
        if threshold is not None:
            self.threshold = check_number("threshold", threshold, 0, low_open=True)
        self.factor = check_number("factor", factor, 1, low_open=True)
        self.register_buffer("scale", torch.ones(1, dtype=torch.float64))
        self._policy: tuple[TensorDictModuleBase, ...] = ()  # a tuple: not a submodule
        self._first = FirstFrames(str(type(self).__name__), is_init_key)
        self._forget(1)

    def _forget(self, trials: int) -> None:
        self._noise_of = np.zeros((trials, 0))
        self._center: Parameters = {}
        self._perturbed: Parameters = {}
        self._xi = torch.zeros(0, 0)  # of the lanes of this process: no buffer
        self._kl = torch.zeros(2, dtype=torch.float64)  # sum and number of frames

    def allocate(self, policy: TensorDictModuleBase, trials: int) -> None:
        """Set the policy whose parameters are perturbed."""
        for name, parameter in policy.named_parameters():
            if trials > 1 and (parameter.ndim == 0 or len(parameter) != trials):
                raise ValueError(
                    f"the first dimension of every parameter must be the {trials} trials, "
                    f"got {name} of shape {list(parameter.shape)}"
                )
        self._policy = (policy,)
        ones = torch.ones(trials, dtype=torch.float64, device=self.scale.device)
        self.register_buffer("scale", ones)
        self._forget(trials)

    def mixture(self) -> Mixture:
        """Softmax of ``preferences``."""
        return Mixture(softmax=1.0, temperature=self.now("temperature"))

    def begin(self, active: NDArray[np.bool_], episodes: NDArray[np.int64]) -> None:
        """Perturb the parameters of the active trials for one episode."""
        own = self._own()
        trials = len(self.scale)
        size = sum(p.numel() for p in own.values()) // trials
        if self._noise_of.shape[1] != size:
            self._noise_of = np.zeros((trials, size))
        for k in np.flatnonzero(active).tolist():
            trial = self._first_trial + k
            stream = generator(self._seed, Stream.STRATEGY, trial, int(episodes[k]))
            self._noise_of[k] = stream.standard_normal(size)
        sigma = (self.scale * self.sigma).numpy(force=True)  # [trials]
        noise = torch.from_numpy(self._noise_of * sigma[:, None])
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

    def _own(self) -> Parameters:
        """The parameters of the policy."""
        if not self._policy:
            raise ValueError("parameter noise has no policy: call bind(policy, trials) first")
        return {name: p.detach() for name, p in self._policy[0].named_parameters()}

    def preferences(self, tensordict: TensorDictBase, logits: Tensor) -> Tensor:
        """The logits of the perturbed policy."""
        if self._perturbed:
            found = self._logits(self._perturbed, tensordict)
            return torch.where(logits == -torch.inf, logits, found)
        found = self._of_lanes(tensordict).reshape(logits.shape)
        found = torch.where(logits == -torch.inf, logits, found)
        if self.threshold is not None:
            distance = self._divergence(logits, found).sum()
            number = torch.full_like(distance, found[..., 0].numel())
            self._kl = self._kl.to(logits.device) + torch.stack([distance, number])
        return found

    @torch.no_grad()
    def _of_lanes(self, tensordict: TensorDictBase) -> Tensor:
        """The logits of the perturbed policy, with one perturbation for each lane."""
        own, policy = self._own(), self._policy[0]
        given = tensordict.select(*policy.in_keys, strict=False)
        sizes = [p.numel() for p in own.values()]
        like = next(iter(own.values()))
        shape = (given.batch_size.numel(), sum(sizes))
        fresh = torch.randn(shape, dtype=like.dtype, device=like.device)
        first = self._first(tensordict, given.batch_size).reshape(-1, 1)
        if self._xi.shape != shape or self._xi.device != like.device:
            self._xi = fresh
        else:
            self._xi = torch.where(first, fresh, self._xi)
        sigma = (self.scale * self.sigma).to(like.dtype)[0]

        def perturbed(xi: Tensor, frame: TensorDictBase) -> Tensor:
            parts = zip(own.items(), xi.split(sizes), strict=True)
            moved = {name: p + sigma * part.reshape(p.shape) for (name, p), part in parts}
            found = functional_call(policy, moved, (frame.unsqueeze(0),))
            return found.get(self.logits_key).squeeze(0)

        lanes = given.reshape(-1)
        try:
            return torch.vmap(perturbed, randomness="different")(self._xi, lanes)
        except RuntimeError:  # vmap does not know every operation, such as a branch on data
            return torch.stack([perturbed(*lane) for lane in zip(self._xi, lanes, strict=True)])

    def _logits(self, parameters: Parameters, tensordict: TensorDictBase) -> Tensor:
        policy = self._policy[0]
        given = tensordict.select(*policy.in_keys, strict=False)
        with torch.no_grad():
            return functional_call(policy, parameters, (given,)).get(self.logits_key)

    def behaviour_parameters(self, parameters: Sequence[Tensor]) -> list[Tensor]:
        """The perturbed parameters."""
        names = {id(parameter): name for name, parameter in self._policy[0].named_parameters()}
        return [self._perturbed[names[id(parameter)]] for parameter in parameters]

    def step(self, frames: TensorDictBase | int | None = None) -> None:
        """Adapt σ."""
        super().step(frames)
        if self.threshold is None:
            return
        if not self._perturbed:
            total, number = self._kl.tolist()
            self._kl = torch.zeros_like(self._kl)
            distance, number = np.array([total / max(number, 1)]), np.array([number])
        elif isinstance(frames, TensorDictBase):
            distance, number = self._distance(self._last_episodes(frames))
        else:
            return
        grow = np.where(distance <= self.threshold, self.factor, 1 / self.factor)
        scale = self.scale.numpy(force=True)
        self.scale.copy_(torch.from_numpy(np.where(number > 0, scale * grow, scale)))

    def _distance(self, data: TensorDictBase) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Mean KL(π‖π̃) over the frames of each trial, and their number, both [trials]."""
        trials = len(self.scale)
        own, other = (
            self._masked(data, self._logits(p, data)) for p in (self._center, self._perturbed)
        )
        trial = self._trials_of(data)
        frames = torch.bincount(trial, minlength=trials)
        total = lane_sum(self._divergence(own, other), trial, trials)
        return (total / frames.clamp(min=1)).numpy(), frames.numpy()

    def _divergence(self, own: Tensor, other: Tensor) -> Tensor:
        """KL(π‖π̃) of two sets of masked logits [*batch], in double."""
        own, other = (self._split(x).double().log_softmax(-1) for x in (own, other))
        terms = torch.where(own == -torch.inf, 0.0, own.exp() * (own - other)).sum(-1)
        return terms.sum(-1) if self.joint else terms

    def _trials_of(self, data: TensorDictBase) -> Tensor:
        trial = self._trial(data)
        return torch.zeros(len(data), dtype=torch.int64) if trial is None else trial

    def _last_episodes(self, data: TensorDictBase) -> TensorDictBase:
        """The frames of every trial's last episode, flat [frames]."""
        data = data.reshape(-1)
        trial = self._trials_of(data)
        done = data.get(("next", "done")).reshape(-1)
        ended = done.cumsum(0) - done.long()  # episodes that ended before the frame
        last = ended.new_zeros(int(trial.max()) + 1).scatter_reduce(0, trial, ended, "amax")
        return data[ended == last[trial]]
