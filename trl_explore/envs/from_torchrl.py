"""A TorchRL environment as a gymnasium environment, so that each trial has a copy of its own."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from tensordict import TensorDictBase
from torchrl.data import Binary, Categorical, Composite, OneHot, TensorSpec
from torchrl.envs import EnvBase
from torchrl.envs.utils import step_mdp

from trl_explore.checks import first_line


class TorchRLEnv(gym.Env[Any, Any]):
    """A TorchRL environment of batch size [] or [1] as a gymnasium environment.

    One environment is for one trial: a batch of environments in one object would share its random
    numbers between the trials. ``reset(seed=...)`` calls ``set_seed``. The observation is the only
    entry of ``observation_spec``, or a Dict of all of them.

    Args:
        target: the class, ``module.Class``.
        kwargs: arguments of its constructor.

    Raises:
        ValueError: if the class does not exist, rejects its arguments, is no ``EnvBase``, or has
            another batch size or specs that gymnasium has no space for.
    """

    def __init__(self, target: str, **kwargs: Any) -> None:
        self.env = _construct(target, kwargs)
        if tuple(self.env.batch_size) not in ((), (1,)):
            raise ValueError(
                f"{target} has batch size {list(self.env.batch_size)}, but must have [], "
                "because each trial has an environment of its own"
            )
        self._batch = tuple(self.env.batch_size)
        specs = {
            "/".join((key,) if isinstance(key, str) else key): (key, self._one(spec))
            for key, spec in self.env.observation_spec.items(True, True)
        }
        if not specs:
            raise ValueError(f"{target} has no observations")
        self._keys = {name: key for name, (key, _) in specs.items()}
        parts = {name: _space(target, name, spec) for name, (_, spec) in specs.items()}
        self._single = next(iter(parts)) if len(parts) == 1 else None
        self.observation_space = parts[self._single] if self._single else spaces.Dict(parts)
        self._action_spec = self.env.action_spec
        self.action_space = _space(target, "action", self._one(self._action_spec), acts=True)
        self._last: TensorDictBase | None = None

    def _one(self, spec: Any) -> TensorSpec:
        return spec[0] if self._batch else spec

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode, with the environment's generator at ``seed``."""
        super().reset(seed=seed)
        if seed is not None:
            self.env.set_seed(seed)
        self._last = self.env.reset()
        return self._observation(self._last), {}

    @torch.no_grad()
    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """One step."""
        assert self._last is not None, "reset comes first"
        tensor = torch.as_tensor(action, dtype=torch.int64 if isinstance(action, int) else None)
        if isinstance(self._action_spec, OneHot | Binary) and isinstance(action, int):
            tensor = torch.nn.functional.one_hot(tensor, self._action_spec.shape[-1])
        tensor = tensor.to(self._action_spec.dtype).reshape(self._action_spec.shape)
        stepped = self.env.step(self._last.set(self.env.action_key, tensor))
        after = stepped.get("next")
        self._last = step_mdp(stepped)
        flags = {
            name: bool(after.get(name, torch.tensor(False)).any())
            for name in ("terminated", "truncated", "done")
        }
        ended = flags["terminated"] or (flags["done"] and not flags["truncated"])
        reward = after.get(self.env.reward_key)
        return self._observation(after), float(reward.reshape(())), ended, flags["truncated"], {}

    def _observation(self, data: TensorDictBase) -> Any:
        parts = {name: self._value(name, data.get(key)) for name, key in self._keys.items()}
        return parts[self._single] if self._single else parts

    def _value(self, name: str, value: torch.Tensor) -> Any:
        space = self.observation_space if self._single else self.observation_space[name]  # pyright: ignore
        array = value.detach().cpu().numpy()
        array = array[0] if self._batch else array
        return int(array) if isinstance(space, spaces.Discrete) else array

    def close(self) -> None:
        """Close the environment."""
        if not self.env.is_closed:
            self.env.close()


def _construct(target: str, kwargs: dict[str, Any]) -> EnvBase:
    module, _, name = target.rpartition(".")
    try:
        env_class = getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"there is no class {target!r}: {first_line(error)}") from error
    try:
        env = env_class(**kwargs)
    except (Exception, SystemExit) as error:
        raise ValueError(
            f"{target} rejects its arguments: {type(error).__name__}: {first_line(error)}"
        ) from error
    if not isinstance(env, EnvBase):
        raise ValueError(f"{target} makes a {type(env).__name__}, not a torchrl.envs.EnvBase")
    return env


def _space(target: str, name: str, spec: TensorSpec, *, acts: bool = False) -> spaces.Space[Any]:
    """The gymnasium space of a TorchRL spec."""
    shape = tuple(spec.shape)
    if isinstance(spec, OneHot) and acts and len(shape) == 1:
        return spaces.Discrete(shape[0])
    if isinstance(spec, Categorical) and shape in ((), (1,)):
        return spaces.Discrete(int(spec.n))
    if isinstance(spec, Composite) or not hasattr(spec, "dtype") or spec.dtype is None:
        raise ValueError(f"{target} has {name} of {type(spec).__name__}, which has no space")
    low = getattr(getattr(spec, "space", None), "low", None)
    high = getattr(getattr(spec, "space", None), "high", None)
    dtype: Any = np.float32 if spec.dtype.is_floating_point or not acts else np.int64
    if not isinstance(low, torch.Tensor) or not isinstance(high, torch.Tensor):
        return spaces.Box(-np.inf, np.inf, shape, dtype)
    low, high = (bound.expand(shape).cpu().numpy().astype(dtype) for bound in (low, high))
    return spaces.Box(low, high, dtype=dtype)
