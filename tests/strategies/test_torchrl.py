"""Strategies in TorchRL programs: state, compiled code, clocks, collectors."""

import copy
from itertools import pairwise

import pytest
import torch
from safetensors.torch import load_model, save_model
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch._dynamo.utils import counters
from torchrl.collectors import Collector
from torchrl.data import Categorical, OneHot
from torchrl.envs import GymEnv, SerialEnv
from torchrl.envs.transforms import InitTracker, TransformedEnv
from torchrl.modules import EGreedyModule, QValueModule

from tests.strategies.samples import OWN, cartpole, data, make, network
from trl_explore import strategies
from trl_explore.strategies import (
    CountBonus,
    EpsilonGreedy,
    EpsilonZGreedy,
    Gaussian,
    ParameterNoise,
    Softmax,
)
from trl_explore.strategies.schedules import Constant, Exponential, Linear


def test_all_strategies_are_found():
    assert {"EpsilonGreedy", "Softmax", "ParameterNoise", "Gaussian", "MeanAction"} <= set(OWN)
    assert not {"Strategy", "MixtureStrategy", "ContinuousStrategy"} & set(OWN)


# State


@pytest.mark.parametrize("name", OWN)
def test_state_is_tensors_that_safetensors_stores(name, tmp_path):
    first, second = (TensorDictSequential(network(3), make(name)) for _ in range(2))
    first[-1].step()
    save_model(first, str(tmp_path / "policy.safetensors"))
    load_model(second, str(tmp_path / "policy.safetensors"))
    theirs = second.state_dict()
    assert all(torch.equal(value, theirs[key]) for key, value in first.state_dict().items())
    assert int(second[-1].iteration) == 1


def test_counts_of_a_used_strategy_are_loaded_without_a_spec():
    used, new = CountBonus(), CountBonus()
    frames = data(5, action=torch.zeros(5, dtype=torch.int64))
    used(frames.exclude("action"))
    used.step(frames)
    new.load_state_dict(used.state_dict(), strict=True)
    logits = torch.zeros(5, 3)
    assert torch.equal(new.preferences(frames, logits), used.preferences(frames, logits))


@pytest.mark.parametrize("name", OWN)
def test_a_strategy_on_the_meta_device_is_refused(name):
    with torch.device("meta"), pytest.raises(ValueError, match=rf"^{name}.*outside.*meta"):
        getattr(strategies, name)()


def test_a_strategy_built_in_inference_mode_moves_outside_it():
    with torch.inference_mode():
        strategy = EpsilonGreedy(Linear(1.0, 0.0, 5))
    strategy.step()
    assert strategy.epsilon.item() == pytest.approx(0.8)


# Compiled and functional use


@pytest.mark.parametrize("name", OWN)
def test_one_graph_is_used_in_every_iteration(name):
    schedule = Exponential(0.9, 0.9)
    kind = getattr(strategies, name)
    parameters = make(name).schedules.keys() if name != "DecayingEpsilonGreedy" else ()
    module = make(name, **dict.fromkeys(parameters, schedule))
    torch._dynamo.reset()
    counters.clear()
    compiled = torch.compile(module, fullgraph=True, backend="eager")
    mask = {} if kind.actions == "continuous" else {"action_mask": torch.ones(6, 3).bool()}
    for _ in range(12):
        compiled(data(6, **mask))
        module.step()
    # One more where the first frame allocates the state of the lanes.
    assert counters["stats"]["unique_graphs"] <= 1 + (
        name in ("EpsilonZGreedy", "CountBonus", "ParameterNoise")
    )


@pytest.mark.parametrize("name", ["EpsilonGreedy", "Softmax", "EpsilonUniform", "VDBE"])
def test_vmap_draws_for_every_element(name):
    strategy = make(name)
    out = torch.vmap(lambda frame: strategy(frame)["action"], randomness="different")(data(40, 2))
    assert out.shape[:2] == (40, 2)
    assert len(out.float().unique(dim=0)) > 1


def test_functional_call_takes_other_parameters():
    strategy = EpsilonGreedy(0.0, spec=Categorical(3))
    frames = data(200, logits=torch.tensor([0.0, 1.0, 0.0]).expand(200, 3))
    state = {name: torch.ones_like(value) for name, value in strategy.named_buffers()}
    out = torch.func.functional_call(strategy, state, (frames.clone(),))["action"]
    assert len(out.unique()) == 3  # ε = 1
    assert strategy(frames)["action"].unique().tolist() == [1]


# Clocks


def test_epsilon_annealed_by_frames_is_that_of_egreedy():
    theirs = EGreedyModule(OneHot(2), eps_init=1.0, eps_end=0.1, annealing_num_steps=1000)
    ours = EpsilonGreedy(Linear(1.0, 0.1, frames=1000), spec=OneHot(2))
    for frames in (1, 100, 250, 7, 0, 900):
        theirs.step(frames)
        ours.step(frames)
        torch.testing.assert_close(ours.epsilon.float(), theirs.eps)
    ours.step(TensorDict({}, [3, 4]))
    assert (int(ours.frames), int(ours.iteration)) == (1258 + 12, 7)


def test_frames_that_are_not_iterations_are_refused():
    strategy = EpsilonGreedy(Linear(1.0, 0.1, iterations=10))
    with pytest.raises(ValueError, match=r"step\(100\).*epsilon counts iterations"):
        strategy.step(100)
    assert float(strategy.epsilon) == 1.0
    strategy.step(data(100))
    assert float(strategy.epsilon) == pytest.approx(0.91)
    EpsilonGreedy(Constant(0.3)).step(100)


def test_every_trial_counts_its_own_frames():
    strategy = Softmax(Linear(2.0, 1.0, frames=10))
    strategy.bind(network(), 2)
    strategy.step(TensorDict({"trial": torch.tensor([0, 1, 1, 1, 1])}, [5]))
    assert strategy.temperature.tolist() == [1.9, 1.6]


# Programs


def test_egreedy_in_torchrls_dqn_is_replaced_in_one_line():
    env = GymEnv("CartPole-v1")
    q = TensorDictModule(torch.nn.Linear(4, 2), ["observation"], ["action_value"])
    explore = EpsilonGreedy(
        Linear(1.0, 0.05, frames=100), spec=env.action_spec, logits_key="action_value"
    )
    policy = TensorDictSequential(q, QValueModule(spec=env.action_spec), explore)
    collector = Collector(
        env, policy, frames_per_batch=50, total_frames=100, auto_register_policy_transforms=False
    )
    for batch in collector:
        explore.step(batch.numel())
        chosen = (batch["action"] * batch["action_value"]).sum(-1, keepdim=True)
        assert (chosen != batch["chosen_action_value"]).any()
    collector.shutdown()
    assert float(explore.epsilon) == pytest.approx(0.05)


def test_a_new_episode_of_one_lane_leaves_the_others_noise_alone():
    env = TransformedEnv(SerialEnv(2, cartpole), InitTracker())
    target = network()
    strategy = ParameterNoise(1.0, spec=env.action_spec)
    strategy.bind(target, 1)
    seen = []
    strategy.register_forward_hook(
        lambda _, frames, out: seen.append((out["is_init"].squeeze(-1), strategy._xi.clone()))
    )
    env.rollout(40, TensorDictSequential(target, strategy), break_when_any_done=False)
    env.close()
    changes = 0
    for (_, before), (first, after) in pairwise(seen):
        assert torch.equal((before != after).any(-1), first)
        changes += int(first.sum())
    assert changes > 0


def test_the_first_frame_of_a_group_begins_the_episode_of_its_lane():
    target = TensorDictModule(torch.nn.Linear(4, 3), [("agents", "x")], [("agents", "logits")])
    strategy = ParameterNoise(
        logits_key=("agents", "logits"),
        action_key=("agents", "action"),
        is_init_key=("agents", "is_init"),
    )
    strategy.bind(target, 1)
    seen = []
    for first in (True, False, True):
        is_init = torch.zeros(2, 5, 1, dtype=torch.bool)
        is_init[1] = first
        agents = TensorDict({"x": torch.randn(2, 5, 4), "is_init": is_init}, [2, 5])
        TensorDictSequential(target, strategy)(TensorDict({"agents": agents}, [2]))
        seen.append(strategy._xi.clone())
    same = [(a == b).all(-1).tolist() for a, b in pairwise(seen)]
    assert same == [[True, True], [True, False]]


def test_repetitions_end_with_the_episode_in_torchrls_collector():
    torch.manual_seed(0)
    env = GymEnv("CartPole-v1", categorical_action_encoding=True)
    strategy = EpsilonZGreedy(1.0, mu=1.01, spec=env.action_spec)
    collector = Collector(
        env, TensorDictSequential(network(), strategy), frames_per_batch=800, total_frames=800,
        auto_register_policy_transforms=False,
    )  # fmt: skip
    (batch,) = collector
    collector.shutdown()
    ends = batch["next", "done"].squeeze(-1)[:-1]
    same = (batch["action"][1:] == batch["action"][:-1])[ends].float().mean()
    assert same < 0.75  # 0.5 expected of about 80


def test_who_cannot_see_where_an_episode_begins_says_so():
    strategy = EpsilonZGreedy(0.5)
    with pytest.warns(UserWarning, match="InitTracker"):
        strategy(TensorDict({"logits": torch.zeros(2, 3)}, [2]))
    copy.deepcopy(strategy)(TensorDict({"logits": torch.zeros(2, 3)}, [2]))  # once


def test_padding_is_not_counted():
    strategy = CountBonus(spec=Categorical(2))
    mask = torch.tensor([[True, True, True], [True, False, False]])
    frames = {"observation": torch.randn(2, 3, 4), "action": torch.zeros(2, 3).long()}
    strategy.step(TensorDict({**frames, "collector": {"mask": mask}}, [2, 3]))
    assert int(strategy.visits.counts.sum()) == int(strategy.frames) == 4


def test_a_gaussian_in_a_group_writes_beside_its_action():
    keys = {"loc_key": ("agents", "loc"), "scale_key": ("agents", "scale")}
    strategy = Gaussian(**keys, action_key=("agents", "action"))
    group = TensorDict({"loc": torch.zeros(3, 2, 1), "scale": torch.ones(3, 2, 1)}, [3, 2])
    assert strategy(TensorDict({"agents": group}, [3]))["agents", "action_log_prob"].shape == (3, 2)
