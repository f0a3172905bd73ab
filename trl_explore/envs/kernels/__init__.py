"""Compiled dynamics of standard environments, each tested against gymnasium.

To add an environment, write three functions and a builder, in any module that is imported before
the collector is built. docs/own_kernel.md shows it on an example; here, ``Catch`` is a short one.

The contract of the functions:

* ``state`` is a float64 array [state_size]; integers are exact in it: ``int(state[0])``. Access it
  and ``observation`` element by element: in the loop they are not contiguous, so ``reshape`` and
  ``view`` do not compile.
* ``action`` is an integer in [0, n_actions). ``step`` returns the reward (a float) and whether the
  episode has *terminated*. The collector applies the time limit, which the environment must have
  (``max_episode_steps``).
* ``observe`` fills the float32 vector that the policy gets: a Box flattened, a Discrete one-hot.
* ``rng`` is the episode's random stream. Draw the same numbers as the environment, in the same
  order: ``np_random.random()`` is ``random(rng)``, ``np_random.uniform(a, b)`` is
  ``a + (b - a) * random(rng)``; a vector takes one call per element, in order. ``integers``,
  ``choice`` and ``normal`` have no counterpart: they consume the stream differently.
* All that depends on the instance goes into ``parameters``, a tuple of numbers and arrays.
  Closures are rejected. Functions may call others decorated with ``kernel_function``, also from
  other files.
* If the environment returns ``info["action_mask"]``, add a fourth function
  ``mask(parameters, state, mask)`` that fills a bool array [n_actions]: ``Kernel(..., mask=mask)``.
* For an environment with a table ``P[state][action]`` of outcomes, write no functions, but call
  ``tabular(env.P, env.initial_state_distrib)``.
* Dozens of episodes are stepped side by side. If ``step`` and ``observe`` neither branch nor call
  a library, the loop over them is vectorised and several times faster (``a if c else b`` of two
  numbers is not a branch; for |x| <= 0.85 use ``elementary.cos_sin``).
* The builder may reject an instance with ``LookupError("reason")``; ``collector=auto`` then uses
  the stepping collector.
"""

from trl_explore.envs.kernels import bsuite, classic_control, swing_up, tables
from trl_explore.envs.kernels.kernel import (
    CompiledEnv,
    Kernel,
    check_kernel,
    kernel_of,
    register_kernel,
)
from trl_explore.envs.kernels.tables import tabular
from trl_explore.numerics.compiled.cache import kernel_function
from trl_explore.numerics.compiled.philox import random

__all__ = [
    "CompiledEnv",
    "Kernel",
    "bsuite",
    "check_kernel",
    "classic_control",
    "kernel_function",
    "kernel_of",
    "random",
    "register_kernel",
    "swing_up",
    "tables",
    "tabular",
]
