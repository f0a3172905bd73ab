"""Compiled arithmetic, its cache on disk, and random streams; knows no reinforcement learning.

Each operation has one formula, written twice: in torch, for any device, shape and dtype, and
compiled, for flat frames on the CPU. ``TWINS`` lists the pairs, and
``tests/numerics/test_twins.py`` compares each. ``dispatch`` is the only way to the compiled code:
it imports it on first use, and never where numba is missing. No sum runs over the frames of more
than one trial, and every sum runs in the order of the frames, so that a trial does not depend on
its neighbours.

Import from the modules: this package imports none of them, so that ``numerics.streams`` needs
neither numba nor torch.

**What depends on versions, and which test notices.**

* numba, the private classes of its cache (``compiled.cache``: ``FunctionCache._index_key``,
  ``IndexDataCacheFile``, ``Dispatcher._cache``, the event "numba:compile"):
  ``tests/numerics/compiled/test_cache.py``.
* numba and llvmlite, the interface of intrinsics (``arrays``, ``elementary``, ``philox``):
  ``test_arrays.py``, ``test_elementary.py`` and ``test_philox.py`` beside it.
* LLVM, which loops become vector instructions: ``test_elementary.py`` reads the machine code for
  ``exp32``, ``log32`` and ``log1p32``. It changes speed, never bits: no function allows a
  reordering of sums or the fusion of a product and a sum, except where ``fma`` is written.
* glibc, the bits of sine and cosine in float64 (``cos_sin``): ``elementary.agree`` compares 20,000
  angles at run time; where one differs, CartPole calls the library.
* numpy, the bits of ``Generator(Philox).random`` and ``SeedSequence`` (``streams``, ``philox``):
  ``test_philox.py``; those of cosine and sine in float32 (``cos32``, ``sin32``), which Acrobot's
  first observation shows: ``tests/envs/kernels/test_transitions.py``.
* The bits of a whole training: ``tests/test_golden.py``.

**What would be lost without it.** Measured on 1,500 softmax trials of CartPole after 25 iterations,
in ns per frame: collecting takes 21.5, the loss and its gradient 10.7.

* ``exp32``, ``log32``, ``log1p32``: collecting 32.6, the loss 27.4 with the C library's functions.
* ``cos_sin``: collecting 27.6 with the C library's; the bits are the same where ``agree`` says so.
* ``dot``: the loss 14.2 with a sum in one row.
* ``columns``: the loss about 12 with a loop, that is 8 to 14 % more; no bit.
* The blocks of eight frames in ``run_returns``: the loss about 13 with a loop over the frames;
  the steps of eight in ``end_of_run`` and ``end_of_episode``: about 12.
* ``borrow``: nothing here (20.0 and 10.6 without). It is kept until it is measured for networks.
* ``cos32``, ``sin32``: no speed. They hold the promise that Acrobot's kernel gives gymnasium's
  bits: ``tests/envs/kernels/test_transitions.py``.
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
    "layers.relu": "layers.plain_activate",
    "layers.relu32": "layers.plain_activate",
    "layers.relu_backward": "layers.plain_activate",
    "layers.softmax_log_prob": "densities.plain_categorical_log_prob",
    "layers.softmax_log_prob_backward": "densities.plain_categorical_log_prob",
    "layers.tanh32": "layers.plain_activate",
    "layers.tanh_backward": "layers.plain_activate",
    "layers.tanh_double": "layers.plain_activate",
    "layers.tanh_single": "layers.plain_activate",
    "philox.begin": "streams.generator",
    "philox.philox_block": "streams.generator",
    "philox.random": "streams.generator",
    "philox.to_unit": "streams.generator",
    "returns.end_of_episode": "returns.plain_return_to_go",
    "returns.end_of_run": "returns.plain_return_to_go",
    "returns.returns": "returns.plain_return_to_go",
    "returns.run_returns": "returns.plain_return_to_go",
    "score.score_dense": "score.plain_linear_softmax_score",
    "score.score_sparse": "score.plain_linear_softmax_score",
    "score.score_two": "score.plain_linear_softmax_score",
}
"""Compiled function, in ``numerics.compiled`` -> its plain twin, in ``numerics`` or a library."""
