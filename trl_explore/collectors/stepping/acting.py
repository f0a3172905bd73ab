"""From an observation to an action in machine code: softmax policies, Gaussian ones, or neither.

Each function gives lane ``row``, the j-th of the running ones, its action:

    act(j, row, frame, explore, weights, mixture, box, state, log)

It writes the action to ``state.action`` [j] and, with its log-probability, to the log. ``load``
prepares a lane for an episode. See ``turn`` for the arguments.
"""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from trl_explore.collectors.compiled_mixtures import compile_mixing, load_point
from trl_explore.collectors.compiled_policies import Network, compile_network
from trl_explore.numerics.compiled.arrays import borrow
from trl_explore.numerics.compiled.cache import kernel_function
from trl_explore.numerics.compiled.elementary import log32
from trl_explore.numerics.compiled.philox import ndtri, random
from trl_explore.numerics.densities import LOG_SQRT_2PI
from trl_explore.strategies.gaussian import COLDEST
from trl_explore.strategies.strategy import BELOW_ONE

_ONE = np.float32(1)


class Form(NamedTuple):
    """Everything that the machine code of a turn depends on.

    Attributes:
        network: the compiled policy; None: torch modules write the actions.
        n_features: the size of an observation.
        n_masks: the size of an action mask; 0: there are no masks.
        n_dims: the size of an action vector; 0: actions are indices.
        exact: whether actions have a log-probability.
    """

    network: Network | None
    n_features: int
    n_masks: int = 0
    n_dims: int = 0
    exact: bool = True


def compile_acting(form: Form) -> tuple[Any, Any]:
    """The functions ``load`` and ``act`` of a form."""
    if form.network is None:
        return _load_nothing, _copy(form.n_dims, form.exact)
    if form.n_dims:
        return _gaussian(form.network, form.n_dims, form.exact)
    return _softmax(form.network, form.n_masks)


@kernel_function
def _load_nothing(row, weights, mixture, state):
    """Nothing to load: torch modules act."""


def _copy(n_dims: int, exact: bool) -> Any:
    """The action that torch modules have written to ``state.given``."""
    size = max(1, n_dims)

    @kernel_function
    def act(j, row, frame, explore, weights, mixture, box, state, log):
        for k in range(size):
            state.action[j * size + k] = state.given[row * size + k]
            log.action[frame * size + k] = state.given[row * size + k]
        if exact:
            log.log_prob[frame] = state.given_log_prob[row]

    return act


def _softmax(network: Network, n_masks: int) -> tuple[Any, Any]:
    """Draw from the mixture of argmax, softmax and uniform."""
    n_features, n_actions = network.sizes[0], network.sizes[-1]
    load_network, logits = compile_network(network)
    mix, draw, first_largest = compile_mixing(n_actions)

    @kernel_function
    def load(row, weights, mixture, state):
        load_network(weights, row, borrow(state.local)[row], state.own, row)
        load_point(mixture, row if mixture.shape[1] > 1 else 0, borrow(state.point)[row])

    @kernel_function
    def act(j, row, frame, explore, weights, mixture, box, state, log):
        probs = borrow(state.out)
        x = borrow(log.observation)[frame * n_features : (frame + 1) * n_features]
        local = borrow(state.local)[row]
        logits(weights, row, local, state.own, row, state.hidden, x, probs)
        for a in range(n_masks):
            probs[a] = probs[a] if log.mask[frame * n_masks + a] else -np.inf
        if explore:
            mix(probs, borrow(state.work), borrow(state.point)[row])
            action, chance = draw(probs, random(borrow(state.rng)[row]))
        else:
            action, chance = first_largest(probs), _ONE
        state.action[j], log.action[frame] = action, action
        log.log_prob[frame] = log32(chance)

    return load, act


def _gaussian(  # noqa: C901 - the parts of one compiled function
    network: Network, n_dims: int, exact: bool
) -> tuple[Any, Any]:
    """Draw from the mixture of mean, Gaussian and uniform; twin: ``ContinuousMixtureStrategy``."""
    n_features = network.sizes[0]
    load_network, network_loc = compile_network(network)

    @kernel_function
    def load(row, weights, mixture, state):
        load_network(weights, row, borrow(state.local)[row], state.own, row)

    @kernel_function
    def act(j, row, frame, explore, weights, mixture, box, state, log):
        loc, scale = borrow(state.out), borrow(state.scale)[row]
        x = borrow(log.observation)[frame * n_features : (frame + 1) * n_features]
        local = borrow(state.local)[row]
        network_loc(weights, row, local, state.own, row, state.hidden, x, loc)
        action = borrow(log.action)[frame * n_dims : (frame + 1) * n_dims]
        column = row if mixture.shape[1] > 1 else 0
        gaussian, uniform = mixture[1, column], mixture[2, column]
        temperature = max(mixture[3, column], COLDEST)
        low, high, volume = box
        if explore:
            u, rng = borrow(state.noise), borrow(state.rng)[row]
            for k in range(n_dims + 1):
                u[k] = random(rng)
            corner = min(u[n_dims], BELOW_ONE)
            for k in range(n_dims):
                wide = np.float64(loc[k])
                if corner < uniform:
                    wide = low[k] + u[k] * (high[k] - low[k])
                elif corner < 1 - mixture[0, column]:
                    z = ndtri(min(max(u[k], 1 - BELOW_ONE), BELOW_ONE))
                    wide += temperature * np.float64(scale[k]) * z
                action[k] = wide
        else:
            for k in range(n_dims):
                action[k] = loc[k]
        for k in range(n_dims):
            state.action[j * n_dims + k] = action[k]
        if exact:
            log.log_prob[frame] = 0
            if explore:
                parts = gaussian, uniform, temperature
                log.log_prob[frame] = density(action, loc, scale, parts, low, high, volume)

    @kernel_function
    def density(action, loc, scale, parts, low, high, volume):
        """Log density of an action, as written."""
        gaussian, uniform, temperature = parts
        of_gaussian = of_uniform = -np.inf
        if gaussian > 0:
            total, inside = 0.0, True
            for k in range(n_dims):
                wide = temperature * np.float64(scale[k])
                z = (np.float64(action[k]) - np.float64(loc[k])) / wide
                total += 0.5 * (z * z) + math.log(wide) + LOG_SQRT_2PI
            of_gaussian = math.log(gaussian) - total
        if uniform > 0:
            inside = True
            for k in range(n_dims):
                inside &= low[k] <= action[k] <= high[k]
            of_uniform = math.log(uniform) - volume[0] if inside else -np.inf
        larger = max(of_gaussian, of_uniform)
        return larger + math.log1p(math.exp(-abs(of_gaussian - of_uniform)))

    return load, act
