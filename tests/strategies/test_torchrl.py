"""Strategies in TorchRL programs: workers, compiled code, groups of agents, specs, clocks."""

import copy
import multiprocessing
import os
import pickle
import warnings
from itertools import pairwise
from multiprocessing import context
from weakref import WeakSet

import pytest
import torch
from safetensors.torch import load_model, save_model
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch._dynamo.utils import counters
from torchrl.collectors import Collector, MultiSyncCollector
from torchrl.data import Bounded, Categorical, Composite, MultiCategorical, MultiOneHot, OneHot
from torchrl.envs import GymEnv, SerialEnv
from torchrl.envs.transforms import InitTracker, TransformedEnv
from torchrl.modules import EGreedyModule, QValueModule

from trl_explore import strategies
from trl_explore.strategies import (
    Argmax,
    CountBonus,
    EpsilonGreedy,
    EpsilonSoftmax,
    EpsilonZGreedy,
    Gaussian,
    ParameterNoise,
    Random,
    Softmax,
    workers,
)
from trl_explore.strategies.schedules import Constant, Exponential, Linear

BOX = Bounded(-1.0, 1.0, shape=(2,))
OWN = [
    name
    for name in strategies.__all__
    if hasattr(getattr(strategies, name), "actions") and not name.endswith("Strategy")
]


def network(n_actions=2):
    return TensorDictModule(torch.nn.Linear(4, n_actions), ["observation"], ["logits"])


def make(name, **options):
    """Any strategy over three actions or a box of two dimensions."""
    kind = getattr(strategies, name)
    strategy = kind(spec=BOX if kind.actions == "continuous" else OneHot(3), **options)
    if isinstance(strategy, ParameterNoise):
        strategy.bind(network(3), 1)
    return strategy


def data(*batch, **entries):
    """Frames with everything that a strategy may read."""
    frames = {
        "logits": torch.randn(*batch, 3),
        "observation": torch.randn(*batch, 4),
        "loc": torch.zeros(*batch, 2),
        "scale": torch.ones(*batch, 2),
        "is_init": torch.zeros(*batch, 1, dtype=torch.bool),
    }
    return TensorDict({**frames, **entries}, batch)


def test_all_strategies_are_found():
    assert {"EpsilonGreedy", "Softmax", "ParameterNoise", "Gaussian", "MeanAction"} <= set(OWN)
    assert not {"Strategy", "MixtureStrategy", "ContinuousStrategy"} & set(OWN)


# Workers


def cartpole():
    return GymEnv("CartPole-v1")


def test_workers_draw_their_own_numbers_and_follow_the_schedule():
    torch.manual_seed(0)
    target = network()
    torch.nn.init.zeros_(target.module.weight)
    target.module.bias.data = torch.tensor([1.0, 0.0])  # action 0 is greedy
    strategy = EpsilonGreedy(Linear(1.0, 0.0, frames=200), spec=OneHot(2))
    policy = TensorDictSequential(target, strategy)
    batches = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        collector = MultiSyncCollector(
            [cartpole] * 2, policy, frames_per_batch=200, total_frames=400,
            auto_register_policy_transforms=False,
        )  # fmt: skip
        for batch in collector:
            batches.append(batch["action"].int().argmax(-1).reshape(2, 100))
            strategy.step(batch.numel())
            collector.update_policy_weights_(policy)
        collector.shutdown()
    first, last = batches
    assert 0.3 < (first[0] == first[1]).float().mean() < 0.7  # ε = 1: half of the actions
    assert last.sum() == 0  # ε = 0


def spawned(strategy):
    """The bytes of a strategy that is an argument of a process being spawned."""
    context.set_spawning_popen(object())
    try:
        return pickle.dumps(strategy)
    finally:
        context.set_spawning_popen(None)


def arrive(sent):
    return pickle.loads(sent)(TensorDict({"logits": torch.zeros(50, 4)}, [50]))["action"]


def test_spawned_processes_get_different_seeds_that_the_parents_seed_decides():
    with torch.random.fork_rng():
        runs = []
        for seed in (1, 1, 2):
            torch.manual_seed(seed)
            sent = [spawned(Random()) for _ in range(2)]
            runs.append([arrive(part) for part in sent])
        one, again, other = runs
        assert all(torch.equal(a, b) for a, b in zip(one, again, strict=True))
        assert not torch.equal(one[0], one[1])
        assert not torch.equal(one[0], other[0])
        torch.manual_seed(3)  # a copy within the process seeds nothing
        pickle.loads(pickle.dumps(Random()))
        assert torch.initial_seed() == 3


def send_actions(strategy, pipe):
    pipe.send(strategy(TensorDict({"logits": torch.zeros(50, 4)}, [50]))["action"].tolist())


@pytest.mark.filterwarnings("ignore:.*fork.*")
def test_without_a_strategy_a_fork_leaves_torchs_generator_alone(monkeypatch):
    monkeypatch.setattr(workers, "_strategies", WeakSet())
    before = torch.get_rng_state()
    child = os.fork()
    if child == 0:
        os._exit(int(not torch.equal(torch.get_rng_state(), before)))
    assert os.waitpid(child, 0)[1] == 0
    assert torch.equal(torch.get_rng_state(), before)


@pytest.mark.filterwarnings("ignore:.*fork.*")
def test_forked_processes_get_different_seeds_that_the_parents_seed_decides():
    fork, found = multiprocessing.get_context("fork"), []
    with torch.random.fork_rng():
        for _ in range(2):
            torch.manual_seed(1)
            for _ in range(2):
                here, there = fork.Pipe()
                process = fork.Process(target=send_actions, args=(Random(), there))
                process.start()
                found.append(here.recv())
                process.join()
    assert found[:2] == found[2:]
    assert found[0] != found[1]


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


# Specs, masks and numbers


@pytest.mark.parametrize("spec", [OneHot(3), Categorical(3)], ids=["one_hot", "categorical"])
def test_a_mask_in_the_spec_is_obeyed(spec):
    strategy = EpsilonGreedy(0.9, spec=Composite(action=spec))
    frames = data(300, logits=torch.tensor([5.0, 1.0, 0.0]).expand(300, 3))
    for legal in ([False, True, True], [True, False, False]):
        spec.update_mask(torch.tensor(legal))
        action = strategy(frames)["action"]
        index = action.int().argmax(-1) if isinstance(spec, OneHot) else action
        assert index.unique().tolist() == torch.tensor(legal).nonzero().flatten().tolist()


@pytest.mark.parametrize("spec", [MultiOneHot([3, 2]), MultiCategorical([3, 2])])
def test_every_head_draws_its_own_action(spec):
    logits = torch.tensor([0.0, 1.0, 2.0, 1.0, 0.0]).expand(20_000, 5)
    strategy = Softmax(spec=spec)
    out = strategy(TensorDict({"logits": logits}, [20_000]))
    assert spec.expand(20_000, *spec.shape).is_in(out["action"])
    heads = out["action"]
    if isinstance(spec, MultiOneHot):
        heads = torch.stack([part.int().argmax(-1) for part in heads.split([3, 2], -1)], -1)
    parts = [part.softmax(-1) for part in logits.split([3, 2], -1)]
    log_probs = [p.gather(-1, heads[:, i : i + 1]).log() for i, p in enumerate(parts)]
    torch.testing.assert_close(out["action_log_prob"], torch.cat(log_probs, -1).sum(-1))
    shares = torch.bincount(heads[:, 0] * 2 + heads[:, 1], minlength=6) / 20_000
    joint = (parts[0][0].unsqueeze(1) * parts[1][0]).flatten()
    torch.testing.assert_close(shares, joint, atol=0.015, rtol=0)
    with strategies_off():
        greedy = strategy(TensorDict({"logits": logits[:1]}, [1]))["action"]
    expected = [[0, 0, 1, 1, 0]] if isinstance(spec, MultiOneHot) else [[2, 0]]
    assert greedy.int().tolist() == expected


def strategies_off():
    from torchrl.envs.utils import ExplorationType, set_exploration_type

    return set_exploration_type(ExplorationType.DETERMINISTIC)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_low_precision_and_many_actions(dtype):
    n = 70_000  # more than the largest float16
    logits = torch.zeros(200, n, dtype=dtype)
    logits[:, 3] = 1
    out = EpsilonGreedy(0.5)(TensorDict({"logits": logits}, [200]))
    assert 60 < int((out["action"] == 3).sum()) < 140
    expected = torch.where(out["action"] == 3, 0.5 + 0.5 / n, 0.5 / n).log()
    torch.testing.assert_close(out["action_log_prob"], expected)


def test_logits_at_the_ends_of_their_type():
    logits = torch.tensor([[3e38, -3e38, 3e38], [-3e38, -torch.inf, -3e38]])
    for strategy in (Argmax(), Softmax(1e-30), EpsilonSoftmax(0.0)):
        out = strategy(TensorDict({"logits": logits.repeat(50, 1)}, [100]))
        assert set(out["action"].tolist()) == {0, 2}
        torch.testing.assert_close(out["action_log_prob"].exp(), torch.full((100,), 0.5))


@pytest.mark.parametrize("strategy", [Argmax, EpsilonGreedy, Softmax, Random])
def test_a_state_without_an_action_is_an_error_unless_it_is_not_checked(strategy):
    entries = {"logits": torch.tensor([[-torch.inf, 1.0]])}
    frames = TensorDict({**entries, "action_mask": torch.tensor([[True, False]])}, [1])
    with pytest.raises(ValueError, match="finite logit"):
        strategy()(frames)
    assert strategy(validate_args=False)(frames)["action_log_prob"].isnan().all()


# Keys


def test_an_observation_called_noise_or_trial_is_not_taken_for_ours():
    entries = {"noise": torch.zeros(400, 2), "trial": torch.full((400,), -7.0)}
    for strategy in (Random(), EpsilonGreedy(1.0), CountBonus()):
        actions = strategy(data(400, logits=torch.zeros(400, 3), **entries))["action"]
        assert len(actions.unique()) == 3


def test_groups_of_agents_do_not_share_an_entry():
    groups = {"left": OneHot(3), "right": Categorical(5)}
    sizes = {"left": (2, 3), "right": (4, 5)}
    frames = TensorDict(
        {
            group: TensorDict(
                {
                    "logits": torch.randn(6, *size),
                    "action_mask": torch.ones(6, *size, dtype=torch.bool).tril(),
                },
                [6, size[0]],
            )
            for group, size in sizes.items()
        },
        [6],
    )
    spec = Composite(
        {group: Composite(action=leaf.expand(sizes[group][0], *leaf.shape), shape=sizes[group][:1])
         for group, leaf in groups.items()}
    )  # fmt: skip
    for group in groups:
        action, logits = (group, "action"), (group, "logits")
        EpsilonGreedy(0.5, spec=spec, logits_key=logits, action_key=action)(frames)
    for group, size in sizes.items():
        assert frames[group, "action_log_prob"].shape == (6, size[0])
        assert (
            spec[group, "action"]
            .expand(6, *spec[group, "action"].shape)
            .is_in(frames[group, "action"])
        )
    index = frames["left", "action"].int().argmax(-1)
    assert (index <= torch.arange(2)).all()  # the mask of the group is obeyed
    assert "action_log_prob" not in frames.keys()  # noqa: SIM118
    with pytest.raises(ValueError, match=r"action_key.*'left', 'action'"):
        EpsilonGreedy(spec=spec)


def test_values_per_trial_in_a_group():
    strategy = EpsilonGreedy([0.0, 1.0], logits_key=("agents", "logits"), trial_key="run")
    logits = torch.tensor([1.0, 0.0, 0.0]).expand(200, 5, 3)
    frames = TensorDict({"agents": {"logits": logits}, "run": torch.arange(200) % 2}, [200])
    actions = strategy(frames)["action"]
    assert (actions[::2] == 0).all()
    assert 0.5 < (actions[1::2] > 0).float().mean() < 0.8


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
