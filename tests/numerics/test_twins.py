"""Every compiled function has a plain twin, names it, and agrees with it."""

from __future__ import annotations

import math
from importlib import import_module
from pkgutil import iter_modules

import numba as nb
import numpy as np
import pytest
import torch
from numba.extending import is_jitted

import trl_explore.numerics.compiled
from trl_explore.numerics import TWINS, dispatch
from trl_explore.numerics.compiled.arrays import WIDTH, columns, dot
from trl_explore.numerics.compiled.elementary import cos32, cos_sin, exp32, log1p32, log32, sin32
from trl_explore.numerics.compiled.layers import relu32
from trl_explore.numerics.compiled.philox import STATE_SIZE, begin, ndtri, random
from trl_explore.numerics.densities import categorical_log_prob
from trl_explore.numerics.layers import activate, lane_linear
from trl_explore.numerics.returns import return_to_go
from trl_explore.numerics.streams import Stream, generator, key
from trl_explore.numerics.surrogate import linear_softmax_surrogate


def draws(*shape, dtype):
    return torch.randn(shape, generator=torch.Generator().manual_seed(len(shape)), dtype=dtype)


def differentiated(function, *inputs):
    """What a function gives, and the gradients of its inputs."""
    leaves = [x.clone().requires_grad_() for x in inputs]
    out = function(*leaves)
    weights = torch.linspace(-1, 2, out.numel(), dtype=out.dtype).reshape(out.shape)
    return [out.detach(), *torch.autograd.grad((out * weights).sum(), leaves)]


TRIAL = torch.arange(60) // 12


def affine(dtype):
    found = []
    for n_out in (3, 9):
        inputs = draws(60, 4, dtype=dtype), draws(5, n_out, 4, dtype=dtype)
        bias = draws(5, n_out, dtype=dtype)
        found += differentiated(lambda x, w, b: lane_linear(x, w, TRIAL, b), *inputs, bias)
    return found


def softmax(dtype):
    action = torch.arange(60) % 3
    logits = draws(60, 3, dtype=dtype)
    return differentiated(lambda x: categorical_log_prob(x, action), logits)


def returns(dtype):
    done = torch.arange(60) % 7 == 6
    return [return_to_go(draws(60, dtype=dtype), done, 0.9, TRIAL)]


def surrogate(dtype):
    """Two actions, three, and one-hot states."""
    found, state = [], torch.nn.functional.one_hot(torch.arange(60) % 8, 8).to(dtype)
    dense = draws(60, 4, dtype=dtype)
    for n_actions, x in ((2, dense), (3, dense), (3, state)):
        weight = draws(5, n_actions, x.shape[1], dtype=dtype)
        action, advantage = torch.arange(60) % n_actions, draws(60, dtype=dtype)
        found += differentiated(
            lambda w, x=x, a=action, f=advantage: linear_softmax_surrogate(x, w, a, f, TRIAL),
            weight,
        )
    return found


OPERATIONS = {
    "layers.plain_lane_linear": affine,
    "densities.plain_categorical_log_prob": softmax,
    "returns.plain_return_to_go": returns,
    "surrogate.plain_linear_softmax_surrogate": surrogate,
}


@nb.njit(error_model="numpy")
def elementary(x, small):
    out = np.empty((6, len(x)), np.float32)
    for i in range(len(x)):
        out[0, i], out[1, i] = exp32(x[i]), log32(abs(x[i]))
        out[2, i], out[3, i], out[4, i] = (
            log1p32(small[i]),
            cos32(small[i]),
            sin32(small[i]),
        )
        out[5, i] = relu32(x[i])
    return out


@nb.njit
def angles(x):
    out = np.empty((2, len(x)))
    for i in range(len(x)):
        out[0, i], out[1, i] = cos_sin(x[i])
    return out


@nb.njit
def stream(stream_key, out):
    rng = np.empty(STATE_SIZE, dtype=np.uint64)
    begin(rng, stream_key, 2, 7)
    for i in range(len(out)):
        out[i] = random(rng)


@nb.njit
def inner(x, y):
    return dot(x, y, len(x) // WIDTH)


@nb.njit
def quantiles(p):
    return np.array([ndtri(x) for x in p])


FIVE = columns(5)


@nb.njit
def transposed(x, out):
    FIVE(x, 0, out, len(x) // WIDTH)


def elementary_pairs():
    x = np.linspace(-80, 80, 5001, dtype=np.float32)
    small = np.linspace(0, 0.78, 5001, dtype=np.float32)
    found, wide, unit = elementary(x, small), x.astype(np.float64), small.astype(np.float64)
    with np.errstate(divide="ignore"):
        yield "numpy.exp", found[0], np.exp(wide)
        yield "numpy.log", found[1], np.log(np.abs(wide))
    yield "numpy.log1p", found[2], np.log1p(unit)
    yield "numpy.cos", found[3], np.cos(unit)
    yield "numpy.sin", found[4], np.sin(unit)
    yield "numpy.maximum", found[5], np.maximum(x, 0)


def other_pairs():
    yield from elementary_pairs()
    x = np.linspace(-1, 1, 501, dtype=np.float32)
    y, slope = differentiated(lambda x: activate(x, "tanh"), torch.from_numpy(x))
    weights = torch.linspace(-1, 2, len(x)).numpy()
    yield "numpy.tanh", y.numpy(), np.tanh(x)
    yield "numpy.tanh", slope.numpy(), weights * (1 - np.tanh(x.astype(np.float64)) ** 2)
    x = np.linspace(-0.85, 0.85, 5001)
    yield "math.cos", angles(x)[0], [math.cos(a) for a in x]
    yield "math.sin", angles(x)[1], [math.sin(a) for a in x]
    stream(key(3, Stream.ACTION), found := np.empty(30))
    yield "streams.generator", found, generator(3, Stream.ACTION, 7, 2).random(30)
    x = np.random.default_rng(0).normal(size=(8 * WIDTH, 5))
    yield "numpy.dot", inner(x[:, 0].copy(), x[:, 1].copy()), np.dot(x[:, 0], x[:, 1])
    transposed(x, found := np.empty((5, len(x))))
    yield "numpy.transpose", found, np.transpose(x)
    p = np.random.default_rng(1).random(1000)
    yield "torch.special.ndtri", quantiles(p), torch.special.ndtri(torch.from_numpy(p)).numpy()


def compiled_functions():
    """Everything in ``numerics.compiled`` that others call: jitted functions and their makers."""
    for module in iter_modules(trl_explore.numerics.compiled.__path__):
        home = import_module(f"trl_explore.numerics.compiled.{module.name}")
        for name, value in vars(home).items():
            python = getattr(value, "py_func", value)
            own = getattr(python, "__module__", None) == home.__name__
            if own and is_jitted(value) and not name.startswith("_"):
                yield f"{module.name}.{name}", python


MAKERS = {"arrays.columns", "arrays.dot", "surrogate.surrogate_many", "surrogate.surrogate_two"}
"""Compiled when they are called, or into their caller: found by their names only."""


def test_every_compiled_function_is_in_the_table_and_names_its_twin():
    assert {name for name, _ in compiled_functions()} | MAKERS == set(TWINS)
    for name, twin in TWINS.items():
        module, function = name.split(".")
        found = getattr(import_module(f"trl_explore.numerics.compiled.{module}"), function)
        text = getattr(found, "py_func", getattr(found, "_defn", found)).__doc__
        assert f"``{twin.split(',')[0]}" in text.split("\n")[0], name


def test_the_twins_exist():
    for twin in {name for names in TWINS.values() for name in names.split(", ")}:
        module, _, function = twin.rpartition(".")
        place = (
            module
            if module in ("math", "numpy", "torch.special")
            else f"trl_explore.numerics.{module}"
        )
        assert callable(getattr(import_module(place), function)), twin


def test_every_twin_is_compared():
    twins = {name for names in TWINS.values() for name in names.split(", ")}
    assert twins == {*OPERATIONS, *(twin for twin, *_ in other_pairs())}


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("twin", OPERATIONS)
def test_operations_agree_with_their_twins(twin, dtype, monkeypatch):
    compiled = OPERATIONS[twin](dtype)
    module = import_module(f"trl_explore.numerics.{twin.split('.')[0]}")
    plain, calls = getattr(module, twin.split(".")[1]), []
    monkeypatch.setattr(module, plain.__name__, lambda *given: calls.append(1) or plain(*given))
    OPERATIONS[twin](dtype)
    assert not calls
    monkeypatch.setattr(dispatch, "has_numba", lambda: False)
    found = OPERATIONS[twin](dtype)
    assert calls
    tolerance = 2e-5 if dtype == torch.float32 else 1e-11
    for ours, theirs in zip(found, compiled, strict=True):
        assert ours.dtype == theirs.dtype
        torch.testing.assert_close(ours, theirs, rtol=tolerance, atol=tolerance)


def test_functions_agree_with_their_twins():
    for twin, found, expected in other_pairs():
        single = np.asarray(found).dtype == np.float32
        tolerance = 1e-6 if single else 1e-14
        np.testing.assert_allclose(found, expected, rtol=tolerance, atol=1e-12, err_msg=twin)
