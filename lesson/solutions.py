"""Solutions of the lesson's exercises. Try first: the checks say what is wrong with an answer."""

import math

import numpy as np

A, B, LEFT, RIGHT = 0, 1, 0, 1
PATHS = [
    ([(A, LEFT)], 1.0),
    ([(A, RIGHT), (B, LEFT)], 0.0),
    ([(A, RIGHT), (B, RIGHT)], 3.0),
]


def softmax(theta):
    """π(a|s), one row per state."""
    powers = np.exp(theta)
    return powers / powers.sum(axis=1, keepdims=True)


def policy_gradient(theta):
    """Exercise 1: Σ_τ P(τ) R(τ) Σ_t ∇log π(a_t|s_t)."""
    pi, total = softmax(theta), np.zeros((2, 2))
    for path, score in PATHS:
        chance = math.prod(pi[step] for step in path)
        for state, action in path:
            total[state] += chance * score * (np.eye(2)[action] - pi[state])
    return total


# Exercise 2: the weights of argmax, softmax and uniform.
corners = {
    "random": (0, 0, 1),
    "argmax": (1, 0, 0),
    "epsilon_greedy": (0.7, 0, 0.3),
    "decaying_epsilon_greedy": (1 - 0.99**100, 0, 0.99**100),
    "softmax": (0, 1, 0),
}


def iteration_to_pass(scores):
    """Exercise 3: the first iteration at which the mean of a full window exceeds 195."""
    for iteration in range(100, len(scores) + 1):
        if np.mean(scores[iteration - 100 : iteration]) > 195:
            return iteration
    return None


def corrected_update(theta, mu):
    """Exercise 4: Σ_τ P_μ(τ) w(τ) R(τ) Σ_t ∇log π(a_t|s_t), with w = Π_t π/μ."""
    pi, total = softmax(theta), np.zeros((2, 2))
    for path, score in PATHS:
        chance = math.prod(mu[step] for step in path)
        weight = math.prod(pi[step] / mu[step] for step in path)
        for state, action in path:
            total[state] += chance * weight * score * (np.eye(2)[action] - pi[state])
    return total


def seeds_to_see(rate):
    """Exercise 5: the chance that n agents all succeed is (1 − rate)^n, and must be below 5 %."""
    return math.ceil(math.log(0.05) / math.log(1 - rate))
