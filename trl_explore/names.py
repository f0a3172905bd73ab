"""Labels for readers: one entry for every strategy, option, parameter and experiment.

Code, files and the command line use keys (``epsilon_greedy``, ``PerStep``); sentences, figures
and tables use these labels. This module imports nothing from the package, so every other module
can import it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class StrategyName:
    """How a strategy is presented to readers.

    Attributes:
        label: its name.
        look: colour, marker and line style in every figure; None: the figure chooses.
        does: what it does; completes "label: ...".

    """

    label: str
    look: tuple[str, str, str] | None
    does: str


STRATEGIES: Mapping[str, StrategyName] = {
    "random": StrategyName("random", ("#6b7280", "s", "dots"),
        "every action is drawn uniformly; nothing that was learned is used"),
    "argmax": StrategyName("argmax", ("#d55e00", "^", "dash-dot"),
        "always the action that the policy prefers; never explores"),
    "epsilon_greedy": StrategyName("ε-greedy", ("#0072b2", "o", "dashes"),
        "with probability ε a random action, else the preferred one"),
    "decaying_epsilon_greedy": StrategyName("decaying ε-greedy", ("#009e73", "D", "long dashes"),
        "ε-greedy with an ε that shrinks in every iteration"),
    "softmax": StrategyName("softmax", ("#a8328c", "v", "solid"),
        "actions are drawn with the probabilities that the policy gives them"),
    "boltzmann": StrategyName("Boltzmann", ("#7a1f3d", "v", "dashes"),
        "softmax at a temperature that falls over the iterations"),
    "mixture": StrategyName("mixture", ("#c28100", "P", "dash-dot-dot"),
        "a weighted mixture of the preferred action, softmax and a random action"),
    "max_boltzmann": StrategyName("max-Boltzmann", ("#697fea", "X", "solid"),
        "with probability ε an action drawn by softmax, else the preferred one"),
    "epsilon_softmax": StrategyName("ε-softmax", ("#3f93cc", "<", "dashes"),
        "with probability ε a random action, else one drawn by softmax"),
    "epsilon_z_greedy": StrategyName("ε-z-greedy", ("#3b2f8f", "h", "dash-dot"),
        "ε-greedy that repeats each random action for a random number of steps"),
    "vdbe": StrategyName("VDBE", ("#2f9a9a", "p", "long dashes"),
        "ε-greedy with an ε that tracks how much the mean score still changes"),
    "count_bonus": StrategyName("count bonus", ("#8c5b5b", ">", "dots"),
        "softmax with a bonus for actions tried less often in a state"),
    "parameter_noise": StrategyName("parameter noise", ("#678c4d", "d", "dash-dot-dot"),
        "softmax of a policy whose weights are perturbed once per episode"),
    "gaussian": StrategyName("Gaussian", None,
        "actions are drawn from the policy’s Gaussian"),
    "epsilon_uniform": StrategyName("ε-uniform", None,
        "with probability ε an action uniform over the box, else one from the Gaussian"),
    "uniform_action": StrategyName("uniform action", None,
        "every action is drawn uniformly from the box; nothing that was learned is used"),
    "mean_action": StrategyName("mean action", None,
        "always the mean of the policy’s Gaussian; never explores"),
    "epsilon_mean": StrategyName("ε-mean", None,
        "with probability ε an action uniform over the box, else the mean"),
}  # fmt: skip
"""In the order of figures and tables: the thesis's strategies first."""

OPTIONS: Mapping[str, Mapping[str, str]] = {
    "correction": {
        "NoCorrection": "uncorrected",
        "PerStep": "per-step ratio",
        "PerDecision": "per-decision weights",
        "Trajectory": "trajectory weights",
        "Behaviour": "gradient of μ",
        "AsIf": "bias of",
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
"""Group -> class of an option -> label; the first option of a group is the thesis's."""

SYMBOLS: Mapping[str, str] = {
    "epsilon": "ε", "decay": "decay rate", "temperature": "T", "sigma": "σ", "delta": "δ",
    "beta": "β", "gamma": "γ", "lr": "learning rate", "baseline.lr": "learning rate of the critic",
    "baseline.value": "baseline", "baseline.decay": "decay of the baseline",
    "optimizer": "optimiser",
    "env": "environment", "entropy_coeff": "entropy coefficient",
}  # fmt: skip
"""Parameter, or key of the configuration -> symbol or words."""


@dataclass(frozen=True)
class ExperimentName:
    """How an experiment is presented to readers.

    Attributes:
        title: heading of its section.
        grid: whether it is a grid over one strategy parameter.
        why: whether its corrections separate bias from exploration.

    """

    title: str
    grid: bool = False
    why: bool = False


EXPERIMENTS: Mapping[str, ExperimentName] = {
    "thesis": ExperimentName("The five strategies"),
    "thesis_learning": ExperimentName("The five strategies, judged by what they learn"),
    "long_runs": ExperimentName("The five strategies, up to 5,000 iterations"),
    "corrections": ExperimentName("Strategies and corrections", why=True),
    "corrections_temperature": ExperimentName("Temperatures and corrections", why=True),
    "why": ExperimentName("Acting, bias and data"),
    "why_as_if": ExperimentName("Softmax with the bias of other strategies"),
    "debug": ExperimentName("A test run"),
    "epsilon_grid": ExperimentName("The choice of ε", grid=True),
    "decay_grid": ExperimentName("The choice of the decay rate", grid=True),
    "temperature_grid": ExperimentName("The choice of the temperature", grid=True),
    "mixture_plane": ExperimentName("The plane of ε and temperature"),
    "baselines": ExperimentName("Baselines"),
    "baselines_batch": ExperimentName("Baselines, with four episodes per update"),
    "deep_policy": ExperimentName("Linear and deeper policies"),
    "frozenlake": ExperimentName("FrozenLake"),
    "deep_sea": ExperimentName("Episodes to the first reward"),
}
"""In report order; an experiment without an entry is placed where ``debug`` is."""


def strategy_label(name: str) -> str:
    """The label of a strategy: ``epsilon_greedy`` -> ε-greedy.

    >>> strategy_label("upper_bound")
    'upper bound'
    """
    return STRATEGIES[name].label if name in STRATEGIES else name.replace("_", " ")


def option_label(group: str, option: str) -> str:
    """The label of an option, given its class.

    >>> option_label("correction", "PerStep")
    'per-step ratio'
    """
    return OPTIONS[group].get(option, option)


def option_of(config: Mapping[str, Any], group: str) -> str:
    """The class of the option that a configuration chooses in a group, such as ``PerStep``.

    If it chooses none: the first option of the group, as in the thesis.
    """
    section = config.get(group)
    target = section.get("_target_") if isinstance(section, Mapping) else None
    return str(target).rsplit(".", 1)[-1] if target else next(iter(OPTIONS[group]))


def symbol(key: str) -> str:
    """The label of a parameter or of a key of the configuration: ``temperature`` -> T.

    >>> symbol("correction._target_"), symbol("optimizer.lr"), symbol("strategy.n_steps")
    ('correction', 'learning rate', 'n steps')
    """
    key = key.removesuffix("._target_")
    last = key.rsplit(".", 1)[-1]
    return SYMBOLS.get(key, SYMBOLS.get(last, last.strip("_").replace("_", " ")))


def experiment(name: str) -> ExperimentName:
    """The entry of an experiment; without one, its name is its title."""
    return EXPERIMENTS.get(name, ExperimentName(name))


def experiment_rank(name: str) -> int:
    """The position of an experiment in a report."""
    return list(EXPERIMENTS).index(name if name in EXPERIMENTS else "debug")
