"""Claims whose data are missing are not measured, and no other verdict changes."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.thesis.conftest import finding
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.thesis import CLAIMS
from trl_explore.thesis.study import CAPS, STRATEGIES

GREEDY = ("epsilon_greedy", "decaying_epsilon_greedy")
NEEDS: dict[str, tuple[str, ...]] = {
    "score.extremes_perform_poorly": ("random", "argmax"),
    "score.others_pass_almost_every_time": (*GREEDY, "softmax"),
    "iterations.decaying_fewer_than_epsilon_greedy": GREEDY,
    "iterations.softmax_fewest": STRATEGIES,
    "iterations.epsilon_greedy_most": (*GREEDY, "softmax"),
    "time.random_least": STRATEGIES,
    "time.epsilon_greedies_alike": GREEDY,
    "time.softmax_least": STRATEGIES,
    "conclusion.strategies_matter": STRATEGIES,
    "conclusion.softmax_performs_best": STRATEGIES,
    "setup.late_trials_never_converge": ("long_runs",),
    "mechanism.argmax_remains_stuck": ("long_runs",),
    "mechanism.decaying_outliers_stuck": ("long_runs",),
    "mechanism.epsilon_greedy_never_optimal": ("epsilon_greedy",),
    "mechanism.preferred_beats_uniform": ("corrections",),
    "outlook.temperature_improves": ("corrections_temperature",),
    "outlook.acting_temperature_improves": ("temperature_grid",),
    "outlook.baseline_drastic": ("baselines",),
}
"""The data of the claims whose id does not name the one experiment or strategy."""


def needs(claim_id: str) -> set[str]:
    theme, _, text = claim_id.partition(".")
    named = (s for s in STRATEGIES if text.startswith(f"{s.replace('ing_epsilon_greedy', 'ing')}_"))
    needed = (
        {theme}
        if theme.endswith("grid")
        else set(NEEDS[claim_id] if claim_id in NEEDS else [next(named)])
    )
    return needed | ({"thesis"} if needed and needed <= set(STRATEGIES) else set())


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda c: c.id)
def test_missing_data_are_not_measured(builder, claim):
    builder.trials = 30
    study = builder.study()
    without = {
        what: [o for o in study.outcomes if what not in (o.experiment, thesis_strategy(o))]
        for what in (*CAPS, *STRATEGIES)
    }
    poorer = {what: replace(study, outcomes=o) for what, o in without.items()}
    before = finding(study, claim.id)
    for what, less in poorer.items():
        found = finding(less, claim.id)
        if what in needs(claim.id):
            assert found.verdict == "not measured", what
            assert found.evidence
        else:
            assert found.verdict in (before.verdict, "open"), what
    assert finding(replace(study, outcomes=[]), claim.id).verdict == "not measured"


def test_a_claim_about_no_value_is_not_measured(builder):
    """Nothing is above the median of a grid of one value."""
    study = builder.study()
    others = [o for o in study.outcomes if o.experiment != "decay_grid"]
    grid = study.grid("decay_grid", "decay")
    for rate in (0.99, max(grid)):
        alone = replace(study, outcomes=[*others, grid[rate]])
        found = finding(alone, "decay_grid.higher_rates_pass")
        assert (found.verdict, bool(found.evidence)) == ("not measured", True)


def thesis_strategy(o: Outcomes) -> str:
    return o.strategy if o.experiment == "thesis" else ""
