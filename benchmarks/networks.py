"""Measure a multilayer perceptron in the fused collector against a loop in torch, and in JAX.

The loops play one episode of CartPole per trial, each trial with its own network of two hidden
layers: the dynamics and the networks of all trials are arrays, and the loop runs until the last
episode has ended. The torch loop draws with ``torch.rand``; the JAX program is one compiled
``while_loop``, measured only where JAX is installed. Times are of the processor, on one thread.
"""

from __future__ import annotations

import math
import os
import statistics
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch
from machine import description, load
from tensordict.nn import TensorDictSequential
from torch import Tensor

from trl_explore.collectors import FusedCollector
from trl_explore.envs import make_env
from trl_explore.policies import MLPPolicy
from trl_explore.strategies import Softmax

HERE = Path(__file__).resolve().parent
TRIALS = (1, 300)
HIDDEN = (32, 64)
STEPS = 500
GRAVITY, POLE_MASS, MASS, LENGTH, FORCE, TAU = 9.8, 0.1, 1.1, 0.5, 10.0, 0.02


def move(state: Any, action: Any, m: Any) -> tuple[Any, Any]:
    """One step of CartPole for all trials, with the functions of the module ``m``."""
    x, v, angle, w = state
    force = FORCE * (2 * action - 1)
    cos, sin = m.cos(angle), m.sin(angle)
    push = (force + POLE_MASS * LENGTH * w * w * sin) / MASS
    turn = (GRAVITY * sin - cos * push) / (LENGTH * (4 / 3 - POLE_MASS * cos * cos / MASS))
    speed = push - POLE_MASS * LENGTH * turn * cos / MASS
    state = x + TAU * v, v + TAU * speed, angle + TAU * w, w + TAU * turn
    return state, (abs(state[0]) > 2.4) | (abs(state[2]) > 12 * math.pi / 180)


def weights(trials: int, hidden: int) -> list[Tensor]:
    """W and b of every layer of a policy."""
    policy = MLPPolicy(make_env("CartPole-v1", trials), hidden=[hidden, hidden])
    module: Any = policy.module
    return [p.detach() for layer in module.layers for p in (layer.weight, layer.bias)]


def fused(trials: int, hidden: int) -> Callable[[], int]:
    """One episode of every trial in the fused collector."""
    env = make_env("CartPole-v1", trials)
    policy: Any = [MLPPolicy(env, hidden=[hidden, hidden]), Softmax()]
    collector = FusedCollector(env, TensorDictSequential(*policy))
    return lambda: len(collector.collect().frames)


@torch.no_grad()
def plain(trials: int, hidden: int) -> Callable[[], int]:
    """The same in a loop over steps in torch."""
    w1, b1, w2, b2, w3, b3 = weights(trials, hidden)

    def episode() -> int:
        state = tuple((torch.rand(4, trials) - 0.5) / 10)
        running, frames, rows = torch.ones(trials, dtype=torch.bool), 0, []
        for _ in range(STEPS):
            x = torch.stack(state, -1)
            y = torch.tanh(torch.baddbmm(b1.unsqueeze(-1), w1, x.unsqueeze(-1)))
            y = torch.tanh(torch.baddbmm(b2.unsqueeze(-1), w2, y))
            log_probs = torch.baddbmm(b3.unsqueeze(-1), w3, y).squeeze(-1).log_softmax(-1)
            action = (torch.rand(trials) >= log_probs[:, 0].exp()).long()
            log_prob = log_probs.gather(-1, action.unsqueeze(-1)).squeeze(-1)
            rows.append((x, action, log_prob, running))
            frames += int(running.sum())
            state, over = move(state, action, torch)
            running = running & ~over
            if not running.any():
                break
        return frames

    return episode


def jax_program(trials: int, hidden: int) -> Callable[[], int]:
    """The same as one compiled program of JAX."""
    import jax  # pyright: ignore[reportMissingImports]
    from jax import numpy as jnp  # pyright: ignore[reportMissingImports]

    w1, b1, w2, b2, w3, b3 = (jnp.asarray(p.numpy()) for p in weights(trials, hidden))

    def layer(w: Any, x: Any, b: Any) -> Any:
        return jnp.einsum("nij,nj->ni", w, x) + b

    def step(carry: Any) -> Any:
        state, running, key, t, record = carry
        x = jnp.stack(state, -1)
        y = jnp.tanh(layer(w2, jnp.tanh(layer(w1, x, b1)), b2))
        log_probs = jax.nn.log_softmax(layer(w3, y, b3))
        key, own = jax.random.split(key)
        action = (jax.random.uniform(own, (trials,)) >= jnp.exp(log_probs[:, 0])).astype(jnp.int32)
        log_prob = jnp.take_along_axis(log_probs, action[:, None], 1)[:, 0]
        new = (x, action, log_prob, running)
        record = tuple(a.at[t].set(b) for a, b in zip(record, new, strict=True))
        state, over = move(state, action, jnp)
        return state, running & ~over, key, t + 1, record

    def going(carry: Any) -> Any:
        return carry[1].any() & (carry[3] < STEPS)

    @jax.jit
    def episode(key: Any) -> Any:
        state = tuple((jax.random.uniform(key, (4, trials)) - 0.5) / 10)
        shapes = ((4,), jnp.float32), ((), jnp.int32), ((), jnp.float32), ((), bool)
        record = tuple(jnp.zeros((STEPS, trials, *shape), dtype) for shape, dtype in shapes)
        start = state, jnp.ones(trials, bool), key, 0, record
        return jax.lax.while_loop(going, step, start)[4][3].sum()

    keys = iter(range(10**9))
    return lambda: int(episode(jax.random.PRNGKey(next(keys))))


KINDS = {"torch loop": plain, "JAX": jax_program, "fused": fused}


def speeds(trials: int, hidden: int, repeats: int) -> dict[str, float]:
    """Median frames per second of every kind; in each round, one after the other."""
    kinds = {k: make for k, make in KINDS.items() if k != "JAX" or find_spec("jax")}
    run = {kind: make(trials, hidden) for kind, make in kinds.items()}
    found: dict[str, list[float]] = {kind: [] for kind in run}
    for repeat in range(repeats + 1):
        for kind, episode in run.items():
            started, frames = time.process_time(), 0
            while time.process_time() - started < 0.2:
                frames += episode()
            if repeat:  # the first one compiles
                found[kind].append(frames / (time.process_time() - started))
    return {kind: statistics.median(values) for kind, values in found.items()}


def document(repeats: int) -> str:
    """The table as Markdown."""
    facts = "\n".join(f"| {name} | {value} |" for name, value in description())
    lines = [
        "# Multilayer perceptrons: the fused collector against other loops\n",
        f"| | this machine |\n|---|---|\n{facts}\n| load average before | {load()} |\n",
        "CartPole, one episode per trial and call, initial weights. Frames per second of processor "
        f"time, medians of {repeats} rounds.\n",
        "| hidden layers | trials | torch loop | JAX | fused | fused / torch | fused / JAX |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    for hidden in HIDDEN:
        for trials in TRIALS:
            s = speeds(trials, hidden, repeats)
            jax = s.get("JAX")
            ratio = s["fused"] / jax if jax else 0.0
            lines.append(
                f"| 2 × {hidden} | {trials} | {s['torch loop']:,.0f} "
                f"| {f'{jax:,.0f}' if jax else ''} | {s['fused']:,.0f} "
                f"| {s['fused'] / s['torch loop']:.1f} "
                f"| {f'{ratio:.1f}' if jax else ''} |"
            )
            print(lines[-1], file=sys.stderr, flush=True)
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")
    torch.set_num_threads(1)
    text = document(repeats=int(sys.argv[1]) if len(sys.argv) > 1 else 5)
    (HERE / "networks.md").write_text(text, encoding="utf-8")
    print(text, end="")
