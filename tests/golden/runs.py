"""The golden run: what is run, and what is kept of it."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from trl_explore.collectors import FusedCollector, TorchRLCollector
from trl_explore.strategies import Argmax, DecayingEpsilonGreedy, EpsilonGreedy, Random, Softmax

FILE = Path(__file__).with_name("golden.json")
STRATEGIES = {
    "random": Random,
    "argmax": Argmax,
    "epsilon_greedy": lambda: EpsilonGreedy(0.3),
    "decaying_epsilon_greedy": lambda: DecayingEpsilonGreedy(0.95),
    "softmax": lambda: Softmax(1.0),
}
COLLECTORS = {"fused": FusedCollector, "torchrl": TorchRLCollector}
RUN = {"seed": 3, "max_iterations": 25, "score_window": 25, "score_threshold": 1e9}


def summary(trainer: Any) -> dict[str, Any]:
    """What is kept of a run."""
    episodes = trainer.trials.episodes()
    scores = episodes["score"].astype("<i8")
    (weight,) = trainer.optimizer.parameters
    return {
        "sha256": hashlib.sha256(scores.tobytes()).hexdigest(),
        "first": scores[episodes["trial"] == 0].tolist(),
        "weight": np.abs(weight.detach().numpy()).mean((1, 2)).tolist(),
    }


def golden() -> dict[str, Any]:
    """What ``golden.json`` says, by strategy."""
    return json.loads(FILE.read_text(encoding="utf-8"))
