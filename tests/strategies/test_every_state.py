"""State and parameters of every discrete strategy: steps, copies, files, values per trial."""

import copy
import io
import pickle
from collections.abc import Sequence

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential

from tests.strategies.from_files import (
    FILES,
    build,
    drawn,
    frames,
    logits_of,
    standalone,
    target,
    unbound,
    uniforms,
)
from trl_explore.strategies import Strategy

pytestmark = pytest.mark.parametrize("name", FILES)


def numbers(name) -> Sequence[str]:
    return [key for key, value in FILES[name].items() if isinstance(value, int | float)]


def test_step_changes_the_schedule_only(name):
    stepped, still = build(name), build(name)
    for _ in range(3):
        stepped.step()
    a, b = (strategy.state_dict() for strategy in (stepped, still))
    for clock in ("iteration", "frames"):
        assert (a.pop(clock), b.pop(clock)) == (3, 0)
    assert a.keys() == b.keys()
    assert all(torch.equal(a[key], b[key]) for key in a.keys() - stepped.schedules.keys())
    ties = frames(torch.zeros(200, 4))
    assert torch.equal(drawn(stepped, ties)["action"], drawn(still, ties)["action"])


def test_drawing_does_not_step(name):
    strategy = build(name, iteration=2)
    before = strategy.probs(logits_of(5))
    for _ in range(3):
        strategy(frames(logits_of(50)))
    assert int(strategy.iteration) == 2
    assert torch.equal(strategy.probs(logits_of(5)), before)


@pytest.mark.parametrize("through_a_file", [False, True])
def test_state_dict_round_trip(name, through_a_file):
    ties = frames(torch.zeros(200, 4), step_count=torch.zeros(200, 1))  # the next episode
    first = build(name, iteration=7)
    first(ties.clone())
    state = first.state_dict()
    if through_a_file:
        file = io.BytesIO()
        torch.save(state, file)
        file.seek(0)
        state = torch.load(file, weights_only=True)
    second = build(name)
    second.load_state_dict(state)
    assert int(second.iteration) == 7
    assert torch.equal(second.probs(logits_of(9)), first.probs(logits_of(9)))
    a, b = drawn(first, ties), drawn(second, ties)
    assert torch.equal(a["action"], b["action"])
    if first.exact:
        assert torch.equal(a["action_log_prob"], b["action_log_prob"])


def test_state_dict_within_a_larger_module(name):
    def whole():
        linear = TensorDictModule(torch.nn.Linear(3, 4), ["observation"], ["logits"])
        return TensorDictSequential(linear, standalone(name, linear))

    first, second = whole(), whole()
    assert len(list(first.parameters())) == 2  # a strategy has none
    first[-1].step()
    second.load_state_dict(first.state_dict())
    starts = torch.ones(100, 1, dtype=torch.bool)
    data = TensorDict({"observation": torch.randn(100, 3), "is_init": starts}, [100])
    assert torch.equal(drawn(first, data)["action"], drawn(second, data)["action"])
    assert int(second[-1].iteration) == 1


@pytest.mark.parametrize(
    "duplicate", [copy.deepcopy, lambda module: pickle.loads(pickle.dumps(module))]
)
def test_copies_draw_the_same_and_are_independent(name, duplicate):
    ties = frames(torch.zeros(200, 4))
    original = build(name, iteration=3)
    original(ties.clone())
    twin, third = duplicate(original), duplicate(original)
    expected = drawn(original, ties)["action"]
    original.step()
    assert torch.equal(drawn(twin, ties)["action"], expected)
    assert torch.equal(drawn(third, ties)["action"], expected)
    assert (int(original.iteration), int(twin.iteration)) == (4, 3)


def test_every_argument_of_its_own_stands_in_the_file(name):
    import inspect

    own = inspect.signature(type(build(name))).parameters.values()
    named = {p.name for p in own if p.kind is not inspect.Parameter.VAR_KEYWORD}
    named = {name for name in named if not name.endswith("_key")}
    shared = set(inspect.signature(Strategy).parameters)
    assert set(FILES[name]) - {"_target_"} == named - shared


def test_parameters_per_trial(name):
    # Each number of the file that may be a list: the trials then are as if each were alone.
    accepted = []
    for key in numbers(name):
        value = FILES[name][key]
        values = [value, value / 2, value / 4]
        try:
            strategy = unbound(name, noise_key="noise", **{key: values})
        except ValueError:
            continue
        accepted.append(key)
        strategy.bind(target(3), 3, seed=0)
        strategy.begin(np.ones(3, dtype=np.bool_), np.zeros(3, dtype=np.int64))
        logits, trial, noise = logits_of(30), torch.arange(30) % 3, uniforms(strategy, 30)
        data = strategy(frames(logits, trial=trial, noise=noise))
        for k, own in enumerate(values):
            rows = trial == k
            alone = build(name, first_trial=k, **{key: own})
            expected = alone(frames(logits[rows], noise=noise[rows]))
            assert torch.equal(data["action"][rows], expected["action"])
            if strategy.exact:
                log_probs = data["action_log_prob"][rows], expected["action_log_prob"]
                torch.testing.assert_close(*log_probs)
        with pytest.raises(ValueError, match="trials"):
            strategy.bind(target(4), 4)
    assert accepted or name not in ("epsilon_greedy", "softmax")


@pytest.mark.parametrize("bad", [float("nan"), -1.0])
def test_numbers_that_make_no_sense_are_refused(name, bad):
    for key in numbers(name):
        with pytest.raises(ValueError, match=rf"{key}\b"):
            build(name, **{key: bad})
