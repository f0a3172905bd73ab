"""Which option of a group an agent was made with, and what readers call it."""

from __future__ import annotations

from collections.abc import Mapping

from trl_explore.statistics.outcomes import Outcomes

NAMES: Mapping[str, Mapping[str, str]] = {
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
"""Group -> class of an option -> its name; the first of a group is what the thesis did."""


def choice(outcomes: Outcomes, group: str) -> str:
    """Class of the option that a job was configured with: ``PerStep``.

    Where the configuration does not name any, the first of the group, the thesis's way.
    """
    section = outcomes.config.get(group)
    target = section.get("_target_") if isinstance(section, Mapping) else None
    return str(target).rsplit(".", 1)[-1] if target else next(iter(NAMES[group]))


def choice_name(name: str, group: str) -> str:
    """What readers call an option, given its class.

    >>> choice_name("PerStep", "correction")
    'per-step ratio'
    """
    return NAMES[group].get(name, name)
