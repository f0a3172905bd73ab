"""The words for readers: one entry for every strategy, option, parameter and experiment.

Code, files and the command line use keys (``epsilon_greedy``, ``PerStep``); sentences, figures
and tables use these labels. This module imports nothing of the package, so that every room can
read it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class StrategyName:
    """A strategy for readers.

    Attributes:
        label: what it is called.
        does: what it does, completing "label: ...".
        look: colour, marker and line in every figure; None: the figure chooses.

    """

    label: str
    does: str
    look: tuple[str, str, str] | None = None


STRATEGIES: Mapping[str, StrategyName] = {
    "random": StrategyName(
        "random",
        "every action is drawn uniformly; nothing that was learned is used",
        ("#6b7280", "s", "dots"),
    ),
    "argmax": StrategyName(
        "argmax",
        "always the action that the policy prefers; never explores",
        ("#d55e00", "^", "dash-dot"),
    ),
    "epsilon_greedy": StrategyName(
        "ε-greedy",
        "with probability ε a random action, else the preferred one",
        ("#0072b2", "o", "dashes"),
    ),
    "decaying_epsilon_greedy": StrategyName(
        "decaying ε-greedy",
        "the same, with an ε that shrinks in every iteration",
        ("#009e73", "D", "long dashes"),
    ),
    "softmax": StrategyName(
        "softmax",
        "actions are drawn with the probabilities that the policy gives them",
        ("#a8328c", "v", "solid"),
    ),
    "boltzmann": StrategyName(
        "Boltzmann",
        "softmax at a temperature that falls from iteration to iteration",
        ("#7a1f3d", "v", "dashes"),
    ),
    "mixture": StrategyName(
        "mixture",
        "the preferred action, softmax and a random action, each with a share",
        ("#c28100", "P", "dash-dot-dot"),
    ),
    "max_boltzmann": StrategyName(
        "max-Boltzmann",
        "with probability ε an action by softmax, else the preferred one",
        ("#697fea", "X", "solid"),
    ),
    "epsilon_softmax": StrategyName(
        "ε-softmax",
        "with probability ε a random action, else one by softmax",
        ("#3f93cc", "<", "dashes"),
    ),
    "epsilon_z_greedy": StrategyName(
        "ε-z-greedy",
        "ε-greedy whose random actions are repeated for a random time",
        ("#3b2f8f", "h", "dash-dot"),
    ),
    "vdbe": StrategyName(
        "VDBE",
        "ε-greedy with an ε that follows how much the mean score still changes",
        ("#2f9a9a", "p", "long dashes"),
    ),
    "count_bonus": StrategyName(
        "count bonus",
        "softmax that prefers what has been tried less often in a state",
        ("#8c5b5b", ">", "dots"),
    ),
    "parameter_noise": StrategyName(
        "parameter noise",
        "softmax of a policy whose weights are perturbed once per episode",
        ("#678c4d", "d", "dash-dot-dot"),
    ),
    "gaussian": StrategyName(
        "Gaussian", "actions are drawn from the Gaussian that the policy gives"
    ),
    "epsilon_uniform": StrategyName(
        "ε-uniform", "with probability ε any action of the box, else one by the Gaussian"
    ),
    "uniform_action": StrategyName(
        "uniform action",
        "any action of the box, drawn uniformly; nothing that was learned is used",
    ),
    "mean_action": StrategyName(
        "mean action", "always the mean of the policy’s Gaussian; never explores"
    ),
    "epsilon_mean": StrategyName(
        "ε-mean", "with probability ε any action of the box, else the mean"
    ),
}
"""In the order of figures and tables: those of the thesis first."""

OPTIONS: Mapping[str, Mapping[str, str]] = {
    "correction": {
        "NoCorrection": "uncorrected",
        "PerStep": "per-step ratio",
        "PerDecision": "per-decision weights",
        "Trajectory": "trajectory weights",
        "Behaviour": "gradient of μ",
    },
    "baseline": {
        "Constant": "no baseline",
        "EpisodeMean": "episode mean",
        "StepMean": "mean by step",
        "LinearValue": "linear critic",
        "LeaveOneOut": "leave-one-out",
    },
    "policy": {
        "LinearPolicy": "linear policy",
        "MLPPolicy": "network",
        "TabularPolicy": "table",
        "GaussianLinearPolicy": "linear policy",
        "GaussianMLPPolicy": "network",
    },
}
"""Group -> class of an option -> its label; the first of a group is what the thesis did."""

SYMBOLS: Mapping[str, str] = {
    "epsilon": "ε",
    "decay": "decay rate",
    "temperature": "T",
    "sigma": "σ",
    "delta": "δ",
    "beta": "β",
}
"""Parameter of a strategy -> its symbol."""


@dataclass(frozen=True)
class ExperimentName:
    """An experiment for readers.

    Attributes:
        title: heading of its section.
        grid: whether it is a grid over one parameter of a strategy.
        why: whether its corrections tell bias from exploration.

    """

    title: str
    grid: bool = False
    why: bool = False


EXPERIMENTS: Mapping[str, ExperimentName] = {
    "thesis": ExperimentName("The five strategies"),
    "corrections": ExperimentName("Strategies and corrections", why=True),
    "corrections_temperature": ExperimentName("Temperatures and corrections", why=True),
    "debug": ExperimentName("A trial of the program"),
    "epsilon_grid": ExperimentName("The choice of ε", grid=True),
    "decay_grid": ExperimentName("The choice of the decay rate", grid=True),
    "temperature_grid": ExperimentName("The choice of the temperature", grid=True),
    "mixture_plane": ExperimentName("The plane of ε and temperature"),
    "baselines": ExperimentName("Baselines"),
    "baselines_batch": ExperimentName("Baselines, with four episodes per update"),
    "deep_policy": ExperimentName("Linear and deeper policies"),
    "frozenlake": ExperimentName("FrozenLake"),
}
"""In the order of a report; experiments without an entry stand where ``debug`` does."""


def strategy_label(name: str) -> str:
    """A strategy as readers call it: ``epsilon_greedy`` is ε-greedy.

    >>> strategy_label("upper_bound")
    'upper bound'
    """
    return STRATEGIES[name].label if name in STRATEGIES else name.replace("_", " ")


def option_label(group: str, option: str) -> str:
    """An option as readers call it, given its class.

    >>> option_label("correction", "PerStep")
    'per-step ratio'
    """
    return OPTIONS[group].get(option, option)


def option_of(config: Mapping[str, Any], group: str) -> str:
    """The class of the option that a configuration has of a group: ``PerStep``.

    Where the configuration does not name any, the first of the group, as in the thesis.
    """
    section = config.get(group)
    target = section.get("_target_") if isinstance(section, Mapping) else None
    return str(target).rsplit(".", 1)[-1] if target else next(iter(OPTIONS[group]))


def symbol(key: str) -> str:
    """What readers call a parameter or a group: ``temperature`` is T.

    >>> symbol("correction._target_")
    'correction'
    """
    last = key.rsplit(".", 1)[-1].strip("_").replace("_", " ")
    first = key.split(".", 1)[0]
    parameter = SYMBOLS.get(first, first.replace("_", " "))
    if key in SYMBOLS or last == "target" or key == "baseline.value":
        return parameter
    return f"{last} {parameter}" if first in SYMBOLS else last


def experiment(name: str) -> ExperimentName:
    """The entry of an experiment; one without an entry has its name as its title."""
    return EXPERIMENTS.get(name, ExperimentName(name))


def experiment_rank(name: str) -> int:
    """Where an experiment stands in a report."""
    return list(EXPERIMENTS).index(name if name in EXPERIMENTS else "debug")
