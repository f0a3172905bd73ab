import numba as nb
import numpy as np
import pytest

from trl_explore.numerics.compiled.arrays import MOST_COLUMNS, WIDTH, columns, dot

DTYPES = pytest.mark.parametrize("dtype", [np.float32, np.float64])


@nb.njit
def dot_of(x, y, groups):
    return dot(x, y, groups)


@DTYPES
def test_dot_by_hand(dtype):
    # 2^0 ... 2^15 against ones: exact in any order.
    x, y = 2.0 ** np.arange(16).astype(dtype), np.ones(16, dtype)
    assert dot_of(x, y, 2) == 2**16 - 1
    assert dot_of(x, y, 1) == 2**8 - 1
    assert dot_of(x, y, 0) == 0


@DTYPES
def test_dot_is_a_sum_in_double_in_the_order_that_it_states(dtype):
    x, y = np.random.default_rng(0).normal(size=(2, 10 * WIDTH)).astype(dtype)
    sums = [0.0] * WIDTH
    for i, (a, b) in enumerate(zip(x.tolist(), y.tolist(), strict=True)):
        sums[i % WIDTH] += a * b
    while len(sums) > 1:
        half = len(sums) // 2
        sums = [a + b for a, b in zip(sums[:half], sums[half:], strict=True)]
    assert dot_of(x, y, 10) == sums[0]


@DTYPES
def test_dot_does_not_depend_on_the_place_in_memory(dtype):
    x, y = np.random.default_rng(1).normal(size=(2, 4 * WIDTH)).astype(dtype)
    for shift in range(WIDTH):
        here, there = np.empty(5 * WIDTH, dtype), np.empty(5 * WIDTH, dtype)
        a, b = here[shift : shift + 4 * WIDTH], there[3 : 3 + 4 * WIDTH]
        a[:], b[:] = x, y
        assert dot_of(a, b, 4) == dot_of(x, y, 4)


@DTYPES
@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 8, 13, MOST_COLUMNS, MOST_COLUMNS + 1, 40])
def test_columns_of_some_rows(n, dtype):
    take = columns(n)

    @nb.njit
    def call(x, start, out, groups):
        take(x, start, out, groups)

    x = np.arange(60 * n).reshape(60, n).astype(dtype)
    for start, groups in ((0, 1), (3, 5), (20, 5), (7, 0)):
        out = np.full((n, 6 * WIDTH), -1, dtype)
        call(x, start, out, groups)
        size = WIDTH * groups
        np.testing.assert_array_equal(out[:, :size], x[start : start + size].T)
        assert (out[:, size:] == -1).all()
