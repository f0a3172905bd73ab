import numpy as np
import pytest

from trl_explore.statistics.pairing import (
    check_comparable,
    configuration_key,
    deduplicate,
    pair_indices,
    pool,
    refuse_shared,
    select,
    shared_trials,
    trial_keys,
)


@pytest.fixture
def thesis(make):
    return make([300, 400, 1000], strategy="epsilon_greedy", parameters={"epsilon": 0.3})


@pytest.fixture
def grid(make):
    return make(
        [300, 400],
        strategy="epsilon_greedy",
        parameters={"epsilon": 0.3},
        experiment="epsilon_grid",
        name="epsilon=0.3",
    )


def test_pairs_by_seed_and_trial(make):
    a = make([1, 2, 3, 4], first_trial=0)
    b = make([1, 2, 3], first_trial=2, strategy="argmax")
    i, j = pair_indices(a, b)
    assert i.tolist() == [2, 3]
    assert j.tolist() == [0, 1]
    i, j = pair_indices(a, make([1, 2], seed=1))
    assert len(i) == len(j) == 0


def test_pairs_follow_the_keys_and_not_the_order(make):
    a = make([10, 20, 30])
    b = select(make([1, 2, 3], strategy="argmax"), np.array([2, 0, 1]))
    i, j = pair_indices(a, b)
    assert a.trial[i].tolist() == b.trial[j].tolist() == [0, 1, 2]


def test_a_trial_twice_in_one_job_is_refused(make):
    twice = select(make([1, 2]), np.array([0, 1, 1]))
    with pytest.raises(ValueError, match=r"seed 0, trial 1.*twice"):
        trial_keys(twice)


def test_thesis_and_grid_share_trials(thesis, grid):
    (shared,) = shared_trials([thesis, grid])
    assert shared.first == ("thesis", "epsilon_greedy")
    assert shared.second == ("epsilon_grid", "epsilon=0.3")
    assert shared.count == 2
    with pytest.raises(ValueError, match=r"epsilon_grid/epsilon=0\.3.* 2 trials"):
        refuse_shared([thesis, grid])


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 1},
        {"first_trial": 10},
        {"parameters": {"epsilon": 0.2}},
        {"strategy": "other"},
        {"config": {"env": {"id": "Acrobot-v1"}}},
        {"config": {"optimizer": {"lr": 0.1}}},
    ],
)
def test_other_trials_are_not_shared(thesis, make, change):
    options = {"strategy": "epsilon_greedy", "parameters": {"epsilon": 0.3}} | change
    assert shared_trials([thesis, make([300, 400], **options)]) == []


@pytest.mark.parametrize(
    "config", [{"trials": 20}, {"experiment": "epsilon_grid"}, {"collector": "fused"}]
)
def test_how_it_was_run_makes_no_other_trial(thesis, make, config):
    options = {"strategy": "epsilon_greedy", "parameters": {"epsilon": 0.3}}
    again = make([300], config=config, cap=5000, **options)
    assert shared_trials([thesis, again])[0].count == 1


def test_key_knows_numbers_from_their_spelling(make):
    one, same, true = (make([1], parameters={"t": x}) for x in (1, 1.0, True))
    assert configuration_key(one) == configuration_key(same) != configuration_key(true)
    nested = [make([1], config={"env": {"a": [x, {"b": x}]}}) for x in (2, 2.0, 3)]
    keys = [configuration_key(o) for o in nested]
    assert keys[0] == keys[1] != keys[2]


def test_deduplicate_keeps_the_first_of_each(thesis, grid, make):
    assert deduplicate([thesis, grid]) == [thesis]
    kept = deduplicate([grid, thesis])
    assert kept[0] is grid
    assert kept[1].trial.tolist() == [2]
    assert kept[1].iterations.tolist() == [1000]
    other = make([5, 6])
    assert deduplicate([thesis, other]) == [thesis, other]
    refuse_shared(kept)


def test_pool_of_two_seeds(make):
    pooled = pool([make([1, 2]), make([3, 4, 5], seed=1, name="again")])
    assert pooled.name == "softmax"
    assert pooled.iterations.tolist() == [1, 2, 3, 4, 5]
    assert pooled.seed.tolist() == [0, 0, 1, 1, 1]
    assert len(set(trial_keys(pooled))) == 5


def test_pool_refuses(make, thesis, grid):
    with pytest.raises(ValueError, match="0 jobs"):
        pool([])
    with pytest.raises(ValueError, match="configurations"):
        pool([make([1]), make([1], seed=1, parameters={"temperature": 2})])
    with pytest.raises(ValueError, match=" 2 trials"):
        pool([thesis, grid])
    with pytest.raises(ValueError, match="cap 1000"):
        pool([make([1]), make([1], seed=1, cap=50)])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"cap": 5000}, "cap.*5000"),
        ({"threshold": 475.0}, "threshold 195.*475"),
        ({"window": 10}, "window 100.*10"),
        (
            {"config": {"stop_on": "evaluation", "evaluate_every": 5}},
            "training.*evaluation.*1.*5 iterations",
        ),
    ],
)
def test_other_stopping_rules_are_not_comparable(make, change, message):
    with pytest.raises(ValueError, match=message):
        check_comparable(make([1]), make([1], name="b", **change))


def test_select_by_mask(make):
    o = select(make([1, 2, 3]), np.array([True, False, True]))
    assert o.trial.tolist() == [0, 2]
    assert len(o.status) == len(o.frames) == len(o.score) == 2


def test_correction_and_baseline_make_another_agent(make):
    for group in ("correction", "baseline"):
        one, two = (
            make([300, 400], name=name, config={group: {"_target_": name}}) for name in ("A", "B")
        )
        assert configuration_key(one) != configuration_key(two)
        assert len(deduplicate([one, two])) == 2


def test_the_stopping_rule_that_an_environment_proposes_does_not(make):
    one, two = (
        make([300], config={"env": {"id": "CartPole-v1", "score_threshold": threshold}})
        for threshold in (195.0, 475.0)
    )
    assert configuration_key(one) == configuration_key(two)


def test_nor_do_the_processes_that_step_it(make):
    one, two = (make([300], config={"env": {"id": "Pendulum-v1", "workers": n}}) for n in (1, 8))
    assert configuration_key(one) == configuration_key(two)
    assert shared_trials([one, two])[0].count == 1


def test_evaluations_of_other_frequency_are_another_rule(make):
    def judged(every, count):
        how = {"stop_on": "evaluation", "evaluate_every": every, "evaluate_episodes": count}
        return make([300], config=how)

    check_comparable(judged(5, 2), judged(5, 2))
    for other in (judged(10, 2), judged(5, 1)):
        with pytest.raises(ValueError, match="evaluation"):
            check_comparable(judged(5, 2), other)
    unused = make([300], config={"stop_on": "training", "evaluate_every": 5})
    check_comparable(unused, make([300]))
