"""Affine layers, activations and the log-softmax, compiled; see ``numerics.layers``."""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

import numpy as np

from trl_explore.numerics.compiled.cache import compiled, kernel_function

WIDE = 8
"""The fewest outputs that compiled code computes side by side, as vectors."""

# tanh x ≈ x P(x²) / Q(x²) for |x| <= TANH_LIMIT, with the coefficients of Eigen's float32 function
# (MathFunctionsImpl.h, ptanh_float). One vector instruction can process 16 elements.
TANH_LIMIT = np.float32(7.90531110763549805)
P0, P1, P2, P3, P4, P5, P6 = map(
    np.float32,
    (
        *(4.89352455891786e-03, 6.37261928875436e-04, 1.48572235717979e-05),
        *(5.12229709037114e-08, -8.60467152213735e-11, 2.00018790482477e-13),
        -2.76076847742355e-16,
    ),
)
Q0, Q1, Q2, Q3 = map(
    np.float32,
    (4.89352518554385e-03, 2.26843463243900e-03, 1.18534705686654e-04, 1.19825839466702e-06),
)


@compiled()
def affine(x, out, trial, weight, bias):
    """W x + b for the frames of every trial; twin: ``layers.plain_lane_linear``."""
    trials, n_out, n_in = weight.shape
    columns = np.empty((n_in, n_out), dtype=weight.dtype)
    i = 0
    while i < len(x):
        row = trial[i]
        if not 0 <= row < trials:
            return False
        end = i + 1
        while end < len(x) and trial[end] == row:
            end += 1
        if n_out >= WIDE and end > i + 1:
            columns[:] = weight[row].T
            for f in range(i, end):
                accumulate(columns, x[f], out[f], n_in, n_out)
        else:
            _narrow(x[i:end], weight[row], out[i:end])
        if bias.shape[1] > 0:
            for f in range(i, end):
                for j in range(n_out):
                    out[f, j] += bias[row, j]
        i = end
    return True


@kernel_function
def _narrow(x, weight, out):
    """W x for the frames of one trial, one output at a time."""
    n_out, n_in = weight.shape
    for f in range(len(x)):
        for j in range(n_out):
            total = weight[j, 0] * x[f, 0]
            for k in range(1, n_in):
                total += weight[j, k] * x[f, k]
            out[f, j] = total


@kernel_function
def accumulate(columns, x, out, n_in, n_out):
    """Σ_k columns_k x_k in the order of k, vectorised; twin: ``layers.plain_lane_linear``."""
    for j in range(n_out):
        out[j] = columns[0, j] * x[0]
    k = 1
    while k + 4 <= n_in:
        x0, x1, x2, x3 = x[k], x[k + 1], x[k + 2], x[k + 3]
        c0, c1, c2, c3 = columns[k], columns[k + 1], columns[k + 2], columns[k + 3]
        for j in range(n_out):
            out[j] = (((out[j] + c0[j] * x0) + c1[j] * x1) + c2[j] * x2) + c3[j] * x3
        k += 4
    while k < n_in:
        x0, c0 = x[k], columns[k]
        for j in range(n_out):
            out[j] += c0[j] * x0
        k += 1


@compiled()
def affine_to_input(grad, out, trial, weight):
    """∂/∂x of ``affine``; twin: ``layers.plain_lane_linear``."""
    n_out, n_in = weight.shape[1:]
    for i in range(len(grad)):
        row = trial[i]
        for k in range(n_in):
            out[i, k] = grad[i, 0] * weight[row, 0, k]
        for j in range(1, n_out):
            g = grad[i, j]
            for k in range(n_in):
                out[i, k] += g * weight[row, j, k]


@compiled()
def affine_to_weights(x, grad, trial, slope, slope0):
    """∂/∂W and ∂/∂b of ``affine``, in double; twin: ``layers.plain_lane_linear``."""
    n_out, n_in = slope.shape[1:]
    biased = slope0.shape[1] > 0
    for i in range(len(x)):
        row = trial[i]
        for j in range(n_out):
            g = np.float64(grad[i, j])
            for k in range(n_in):
                slope[row, j, k] += g * x[i, k]
            if biased:
                slope0[row, j] += g


@kernel_function
def tanh32(x):
    """Tanh of a float32; NaN stays NaN; twin: ``numpy.tanh``."""
    x = -TANH_LIMIT if x < -TANH_LIMIT else x
    x = TANH_LIMIT if x > TANH_LIMIT else x
    s = x * x
    p = x * (P0 + s * (P1 + s * (P2 + s * (P3 + s * (P4 + s * (P5 + s * P6))))))
    return p / (Q0 + s * (Q1 + s * (Q2 + s * Q3)))


@kernel_function
def relu32(x):
    """The larger of a float32 and 0; NaN stays NaN; twin: ``numpy.maximum``."""
    return np.float32(0) if x < 0 else x


@compiled()
def tanh(x, y):
    """Tanh of float32 numbers; twin: ``numpy.tanh``."""
    for i in range(len(x)):
        y[i] = tanh32(x[i])


@compiled()
def tanh_backward(y, grad, out):
    """Gradient of tanh from its values; twin: ``numpy.tanh``."""
    for i in range(len(y)):
        out[i] = grad[i] * (np.float32(1) - y[i] * y[i])


@compiled()
def softmax_log_prob(logits, action, probs, out):
    """Log softmax at an action; twin: ``densities.plain_categorical_log_prob``."""
    n = logits.shape[1]
    zero = np.zeros(1, dtype=logits.dtype)[0]
    for i in range(len(logits)):
        largest = logits[i, 0]
        for k in range(1, n):
            largest = max(largest, logits[i, k])
        total = zero
        for k in range(n):
            probs[i, k] = np.exp(logits[i, k] - largest)
            total += probs[i, k]
        for k in range(n):
            probs[i, k] /= total
        out[i] = logits[i, action[i]] - largest - np.log(total)


@compiled()
def softmax_log_prob_backward(probs, action, grad, out):
    """Gradient of ``softmax_log_prob``; twin: ``densities.plain_categorical_log_prob``."""
    n = probs.shape[1]
    for i in range(len(probs)):
        for k in range(n):
            out[i, k] = -grad[i] * probs[i, k]
        out[i, action[i]] += grad[i]
