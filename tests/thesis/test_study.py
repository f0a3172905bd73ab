"""The data that claims use: conditions, pooled seeds, timed trials, and why data are not used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.thesis.conftest import BY_ID, finding, times
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.pairing import select
from trl_explore.thesis import NotMeasuredError, Study, check_claims


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"cap": 200}, "cap 200, the thesis 1000"),
        ({"threshold": 475.0}, "threshold 475.0, the thesis 195.0"),
        ({"window": 10}, "window 10"),
        ({"config": {"env": {"id": "Acrobot-v1"}}}, "environment Acrobot-v1"),
        ({"config": {"stop_on": "evaluation"}}, "stopping scores evaluation"),
        ({"parameters": {"temperature": 2.0}}, "not run with T = 1"),
        ({"converged": np.zeros(5, bool)}, "stopped unconverged after"),
    ],
)
def test_other_conditions_are_not_measured(make, change, reason):
    o = make(**({"durations": [100, 110, 120, 130, 140]} | change))
    found = finding(Study([o]), "score.softmax_passes_consistently")
    assert found.verdict == "not measured"
    assert reason in found.evidence


def test_one_wrong_job_spoils_only_its_own_claims(builder):
    study = builder.study()
    wrong = [replace(o, cap=999) if o.strategy == "random" else o for o in study.outcomes]
    poorer = replace(study, outcomes=wrong)
    assert finding(poorer, "score.random_never_passes").verdict == "not measured"
    assert finding(poorer, "score.softmax_passes_consistently").verdict == "holds"


def test_seeds_are_pooled_and_shared_trials_count_once(make):
    jobs = [
        make(times(100, 180, n=30)),
        make(times(100, 180, n=30), seed=1, name="other seed"),
        make(times(100, 180, n=30), name="again"),
    ]
    found = finding(Study(jobs), "score.softmax_passes_consistently")
    assert found.evidence.startswith("60 of 60")


def test_a_trial_twice_in_a_file_is_not_measured(make):
    twice = select(make([100, 110]), np.array([0, 1, 1]))
    found = finding(Study([twice]), "score.softmax_passes_consistently")
    assert (found.verdict, "occurs twice" in found.evidence) == ("not measured", True)


def test_grid_values_are_numbers_up_to_rounding(make):
    values = [0.1 + 0.2, 0.2, None, "0.4", {"start": 1}]
    jobs = [
        make([k + 100], parameters={"epsilon": v}, experiment="epsilon_grid", name=f"{k}")
        for k, v in enumerate(values)
    ]
    assert list(Study(jobs).grid("epsilon_grid", "epsilon")) == [0.2, 0.3]


def test_several_configurations_are_ambiguous(make):
    jobs = [make([100]), make([100], name="deep", config={"policy": {"depth": 2}})]
    found = finding(Study(jobs), "score.softmax_passes_consistently")
    assert (found.verdict, "several" in found.evidence) == ("not measured", True)


def test_trials_of_the_grid_are_no_evidence_for_the_thesis(make):
    grid = make(
        times(200, 900, n=100),
        strategy="epsilon_greedy",
        parameters={"epsilon": 0.3},
        experiment="epsilon_grid",
    )
    found = finding(Study([grid]), "score.epsilon_greedy_passes_mostly")
    assert found.verdict == "not measured"


def test_seconds_find_their_trials(make):
    o = make([100, 1000, 300, 400], strategy="argmax", first_trial=10)
    by_index = Study([o], {"thesis/argmax": [4.0, 1.0]}, {"thesis/argmax": [13, 11]})
    s = by_index.sample(o, "s")
    assert s.values.tolist() == [4.0, 1.0]
    assert s.converged.tolist() == [True, False]
    assert s.keys == ((0, 13), (0, 11))
    in_order = Study([o], {"thesis/argmax": [4.0, 1.0]}).sample(o, "s")
    assert in_order.keys == ((0, 10), (0, 11))


@pytest.mark.parametrize(
    ("seconds", "trials"),
    [([1.0] * 5, None), ([], None), ([1.0], [99]), ([1.0, 2.0], [10]), ([np.nan], [10])],
)
def test_seconds_that_do_not_fit_are_not_measured(make, seconds, trials):
    o = make([100, 1000, 300, 400], strategy="argmax", first_trial=10)
    study = Study([o], {"thesis/argmax": seconds}, {"thesis/argmax": trials} if trials else {})
    with pytest.raises(NotMeasuredError, match=r"timed trials.*argmax"):
        study.sample(o, "s")


def test_what_was_learned_is_read_from_runs_that_were_not_stopped(make):
    def learned(experiment: str, failing: int) -> Outcomes:
        o = make(times(110, 180, n=400), experiment=experiment, name=experiment)
        score = np.where(np.arange(400) < failing, 50.0, 490.0)
        return replace(
            o,
            learned=score > 195,
            iterations_to_learn=np.where(score > 195, 20, 1000),
            frames_to_learn=o.frames,
            learned_score=score,
            iterations=np.full(400, 1000),
            status=np.full(400, "capped"),
        )

    cut, whole = learned("thesis", 0), learned("thesis_learning", 200)
    claim = BY_ID["score.softmax_passes_consistently"]
    for outcomes, verdict in (([cut], "holds"), ([cut, whole], "does not hold")):
        (checked,) = check_claims(Study(outcomes), [claim])
        assert checked.finding.verdict == "holds"
        assert checked.learned is not None
        assert checked.learned.verdict == verdict
