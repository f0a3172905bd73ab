"""Compiled dynamics of well-known environments, each tested against gymnasium.

An environment of your own takes three functions and a maker, in any module that is imported
before the collector is built. For a corridor in which the floor is slippery:

    from trl_explore.envs.kernels import Kernel, kernel_function, random, register_kernel

    @kernel_function
    def reset(parameters, state, rng):
        state[0] = int(3 * random(rng))

    @kernel_function
    def step(parameters, state, action, rng):
        (length,) = parameters
        slip = random(rng) < 0.2
        state[0] = max(0.0, state[0] + (1 if (action == 1) != slip else -1))
        return -1.0, state[0] >= length

    @kernel_function
    def observe(parameters, state, observation):
        observation[0], observation[1] = state[0], 1

    @register_kernel(Corridor)  # the class of the unwrapped environment
    def corridor(env):
        return Kernel(reset, step, observe, (env.length,), state_size=1, n_features=2, n_actions=2)

    check_kernel(Corridor(length=9))  # side by side with gymnasium, transition by transition

What the functions are given and owe:

* ``state`` is a float64 array [state_size]; whole numbers keep their value in it:
  ``int(state[0])``. Take it and ``observation`` element by element: in the loop their numbers do
  not lie side by side, so that ``reshape`` and ``view`` do not compile.
* ``action`` is an integer in [0, n_actions); ``step`` returns the reward (a float) and whether the
  episode has *terminated*; time limits are the collector's business, and the environment must have
  one (``max_episode_steps``).
* ``observe`` fills the float32 vector that the policy sees: a Box flattened, a Discrete one-hot.
* ``rng`` is the episode's stream. Draw what the environment draws, in the same order:
  ``np_random.random()`` is ``random(rng)``, ``np_random.uniform(a, b)`` is
  ``a + (b - a) * random(rng)``, each number of a vector one call, in order. There is no
  counterpart to ``integers``, ``choice`` and ``normal``, which consume the stream otherwise.
* All that depends on the instance goes through ``parameters``, a tuple of numbers and arrays.
  Functions that close over values are refused. They may call further functions decorated with
  ``kernel_function``, also from other files.
* Where the environment gives ``info["action_mask"]``, a fourth function
  ``mask(parameters, state, mask)`` fills a bool array [n_actions]: ``Kernel(..., mask=mask)``.
* An environment that is a table ``P[state][action]`` of outcomes needs no functions of its own:
  ``tabular(env.P, env.initial_state_distrib)``.
* Dozens of episodes are stepped side by side. Where ``step`` and ``observe`` neither branch nor
  call a library, the loop over them becomes vector instructions, several times as fast
  (``a if c else b`` of two numbers is no branch; ``elementary.cos_sin`` serves for |x| <= 0.85).
* The maker may refuse an instance with ``LookupError("why")``; the TorchRL collector then serves.
"""

from trl_explore.envs.kernels import acrobot, cartpole, mountain_car, toy_text
from trl_explore.envs.kernels.kernel import (
    CompiledEnv,
    Kernel,
    check_kernel,
    kernel_of,
    register_kernel,
)
from trl_explore.envs.kernels.toy_text import tabular
from trl_explore.numerics.compiled.cache import kernel_function
from trl_explore.numerics.compiled.philox import random

__all__ = [
    "CompiledEnv",
    "Kernel",
    "acrobot",
    "cartpole",
    "check_kernel",
    "kernel_function",
    "kernel_of",
    "mountain_car",
    "random",
    "register_kernel",
    "tabular",
    "toy_text",
]
