"""Compiled arithmetic, its cache on disk, and random streams; nothing about reinforcement learning.

Every operation exists twice: in torch, for any device, shape and dtype, and compiled, for flat
frames on the CPU. ``TWINS`` lists the pairs; ``tests/numerics/test_twins.py`` compares each pair.
``dispatch`` is the only way to the compiled code: it imports the code on first use, and never if
numba is missing. Every sum runs over the frames of one trial, in their order, so that the results
of a trial do not depend on the other trials.

Import from the modules. This package imports none of them, so that ``numerics.streams`` needs
neither numba nor torch.

**What depends on library versions, and which test fails if it breaks.**

* numba: the private classes of its cache, used in ``compiled.cache``
  (``FunctionCache._index_key``, ``IndexDataCacheFile``, ``Dispatcher._cache``, the event
  "numba:compile"). Test: ``tests/numerics/compiled/test_cache.py``.
* numba and llvmlite: the interface of intrinsics, used in ``arrays``, ``elementary`` and
  ``philox``. Tests: ``test_arrays.py``, ``test_elementary.py`` and ``test_philox.py`` in the same
  folder.
* LLVM: which loops it vectorises. ``test_elementary.py`` inspects the machine code of ``exp32``,
  ``log32`` and ``log1p32``. This affects speed, never bits: no function allows LLVM to reorder
  sums or to fuse a product and a sum, except where the code says ``fma``.
* glibc: the bits of sine and cosine in float64, which ``cos_sin`` reproduces. At run time
  ``elementary.agree`` compares 20,000 angles; if one differs, CartPole calls the library.
* numpy: the bits of ``Generator(Philox).random`` and ``SeedSequence``, used in ``streams`` and
  ``philox``. Test: ``test_philox.py``.
* numpy: the bits of cosine and sine in float32, which ``cos32`` and ``sin32`` reproduce for
  Acrobot's first observation. Test: ``tests/envs/kernels/test_transitions.py``.
* All of them: the bits of a complete training run. Test: ``tests/test_golden.py``.

docs/speed.md says what each part gains.
"""

TWINS = {
    "arrays.columns": "numpy.transpose",
    "arrays.dot": "numpy.dot",
    "elementary.cos32": "numpy.cos",
    "elementary.cos_sin": "math.cos, math.sin",
    "elementary.exp32": "numpy.exp",
    "elementary.log1p32": "numpy.log1p",
    "elementary.log32": "numpy.log",
    "elementary.sin32": "numpy.sin",
    "layers.accumulate": "layers.plain_lane_linear",
    "layers.affine": "layers.plain_lane_linear",
    "layers.affine_to_input": "layers.plain_lane_linear",
    "layers.affine_to_weights": "layers.plain_lane_linear",
    "layers.relu32": "numpy.maximum",
    "layers.softmax_log_prob": "densities.plain_categorical_log_prob",
    "layers.softmax_log_prob_backward": "densities.plain_categorical_log_prob",
    "layers.tanh": "numpy.tanh",
    "layers.tanh32": "numpy.tanh",
    "layers.tanh_backward": "numpy.tanh",
    "philox.begin": "streams.generator",
    "philox.ndtri": "torch.special.ndtri",
    "philox.philox_block": "streams.generator",
    "philox.random": "streams.generator",
    "philox.to_unit": "streams.generator",
    "returns.end_of_episode": "returns.plain_return_to_go",
    "returns.end_of_run": "returns.plain_return_to_go",
    "returns.returns": "returns.plain_return_to_go",
    "returns.run_returns": "returns.plain_return_to_go",
    "surrogate.surrogate_many": "surrogate.plain_linear_softmax_surrogate",
    "surrogate.surrogate_two": "surrogate.plain_linear_softmax_surrogate",
}
"""Compiled function in ``numerics.compiled`` -> its plain twin in ``numerics`` or a library."""
