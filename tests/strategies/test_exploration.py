"""EpsilonGreedy and Softmax tested as TorchRL tests its exploration modules, and alone."""

import inspect
import subprocess
import sys

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.collectors import Collector
from torchrl.data import Categorical, Composite, MultiCategorical, OneHot
from torchrl.envs import ExplorationType, GymEnv, SerialEnv, set_exploration_type
from torchrl.modules import QValueActor, SafeSequential

from trl_explore.objectives.corrections import AsIf
from trl_explore.strategies import (
    Argmax,
    BaseStrategy,
    EpsilonGreedy,
    EpsilonSoftmax,
    EpsilonZGreedy,
    FullMixture,
    MaxBoltzmann,
    Random,
    Softmax,
    Strategy,
)
from trl_explore.strategies.discrete import Options
from trl_explore.strategies.schedules import Linear
from trl_explore.strategies.strategy import Keys

DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]
SPECS = {"discrete": Categorical(4), "one_hot": OneHot(4), "several": MultiCategorical([4])}
FAMILY = [Random, Argmax, EpsilonGreedy, Softmax, EpsilonSoftmax, MaxBoltzmann, FullMixture]


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("epsilon", [0.0, 0.5, 1.0])
def test_the_share_of_actions_that_explore(epsilon, device):
    torch.manual_seed(0)
    strategy = EpsilonGreedy(epsilon, spec=OneHot(4)).to(device)
    logits = torch.tensor([0.0, 0.0, 1.0, 0.0], device=device).expand(400, 4)
    out = strategy(TensorDict({"logits": logits}, [400], device=device))
    assert out["action"].device.type == out["action_log_prob"].device.type == device
    assert OneHot(4, device=device).expand(400, 4).is_in(out["action"])
    share = float(out["action"][:, 2].float().mean())
    assert share == pytest.approx(1 - 0.75 * epsilon, abs=0.08 if epsilon else 0)


@pytest.mark.parametrize("epsilon", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("kind", [Categorical, OneHot])
def test_masks_under_a_batched_spec_after_a_qvalue_actor(kind, epsilon):
    torch.manual_seed(0)
    batch = (3, 4, 2)
    spec = kind(4).expand(*batch, 4) if kind is OneHot else kind(4).expand(batch)
    actor = QValueActor(nn.Linear(4, 4), spec=kind(4), action_mask_key="action_mask")
    policy = TensorDictSequential(
        actor, EpsilonGreedy(epsilon, spec=spec, logits_key="action_value")
    )
    mask = torch.rand(*batch, 4) < 0.5
    mask[..., 0] |= ~mask.any(-1)
    data = {"observation": torch.zeros(*batch, 4), "action_mask": mask}
    action = policy(TensorDict(data, batch))["action"]
    hot = action if kind is OneHot else nn.functional.one_hot(action, 4)
    assert not hot.bool()[~mask].any()


@pytest.mark.parametrize("parallel_spec", [True, False])
@pytest.mark.parametrize("composite", [True, False])
def test_collector(parallel_spec, composite):
    env = SerialEnv(2, lambda: GymEnv("CartPole-v1"))
    spec = env.action_spec if parallel_spec else env.action_spec_unbatched
    if composite:
        spec = Composite(action=spec, shape=spec.shape[:-1])
    network = TensorDictModule(nn.Linear(4, 2), ["observation"], ["logits"])
    policy = SafeSequential(network, EpsilonGreedy(Linear(1.0, 0.0, frames=20), spec=spec))
    policy(env.reset())
    collector = Collector(
        env, policy, frames_per_batch=20, total_frames=40, auto_register_policy_transforms=False
    )
    for data in collector:
        assert env.action_spec_unbatched.expand(2, 10, 2).is_in(data["action"])
        policy[-1].step(data.numel())
    assert float(policy[-1].epsilon) == 0
    collector.shutdown()


@pytest.mark.parametrize("spec", SPECS)
@pytest.mark.parametrize("strategy", FAMILY)
def test_draws_fit_the_spec_and_their_log_prob(strategy, spec):
    strategy = strategy(spec=SPECS[spec])
    for batch in [(), (5,), (5, 1), (0,), (900,)]:
        out = strategy(TensorDict({"logits": torch.randn(*batch, 4)}, batch))
        assert SPECS[spec].expand(*batch, *SPECS[spec].shape).is_in(out["action"])
        torch.testing.assert_close(strategy.log_prob(out, out["action"]), out["action_log_prob"])


@pytest.mark.parametrize("strategy", FAMILY)
def test_large_batches_are_drawn_from_mu(strategy):
    """Whose memory is laid out for speed."""
    torch.manual_seed(0)
    logits = torch.tensor([0.0, 2.0, -torch.inf, 2.0])
    out = strategy()(TensorDict({"logits": logits.expand(40_000, 4)}, [40_000]))
    mu = strategy().probs(logits)
    shares = out["action"].bincount(minlength=4) / 40_000
    torch.testing.assert_close(shares, mu, atol=0.012, rtol=0)
    torch.testing.assert_close(out["action_log_prob"].exp(), mu[out["action"]])


@pytest.mark.parametrize("kind", list(ExplorationType))
def test_exploration_type(kind):
    logits = torch.tensor([0.0, 0.0, 0.1]).expand(200, 3)
    with set_exploration_type(kind):
        out = Softmax()(TensorDict({"logits": logits}, [200]))
    explores = kind is ExplorationType.RANDOM
    assert (len(out["action"].unique()) > 1) == explores
    assert bool((out["action_log_prob"] == 0).all()) != explores


def test_entries_as_keywords():
    action, log_prob = EpsilonGreedy(0.0)(logits=torch.tensor([[0.0, 1.0]]))
    assert (action.tolist(), log_prob.tolist()) == ([1], [0.0])


def test_logits_that_are_one_number_are_refused():
    with pytest.raises(ValueError, match="'logits' is one number, not one per action"):
        EpsilonGreedy()(TensorDict({"logits": torch.tensor(1.0)}, []))


def test_integer_action_values():
    frames = TensorDict({"logits": torch.tensor([[0, 3, 1]])}, [1])
    assert EpsilonGreedy(0.0)(frames)["action"].tolist() == [1]


def test_vmap_over_epsilon():
    strategy, state = EpsilonGreedy(), dict(EpsilonGreedy().named_buffers())
    logits = torch.tensor([1.0, 0.0, 0.0]).expand(300, 3)

    def act(epsilon):
        frames = TensorDict({"logits": logits}, [300])
        call = torch.func.functional_call
        return call(strategy, {**state, "epsilon": epsilon}, (frames,))["action"]

    none, always = torch.vmap(act, randomness="different")(torch.tensor([0.0, 1.0]))
    assert (none == 0).all()
    assert 0.5 < (always != 0).float().mean() < 0.8


def test_exploration_without_noise_repeats_with_the_seed():
    frames = TensorDict({"logits": torch.randn(2000, 3), "is_init": torch.zeros(2000, 1)}, [2000])
    for strategy in (EpsilonGreedy(0.5), Softmax(), EpsilonZGreedy(0.5)):
        with torch.random.fork_rng():
            torch.manual_seed(1)
            first = strategy(frames.clone())["action"]
            strategy._remaining = strategy._action = torch.zeros(0)  # of EpsilonZGreedy
            torch.manual_seed(1)
            assert torch.equal(first, strategy(frames.clone())["action"])


def test_another_strategy_gives_one_hot_actions_their_probability():
    """Under ``AsIf``, whose strategy needs no spec of its own."""
    logits = torch.tensor([[0.0, 1.0, 0.0]])
    frames = TensorDict({"logits": logits}, [1])
    actor = [lambda data: data]
    hot = torch.tensor([[False, True, False]])
    for spec in (None, OneHot(3)):
        found = AsIf(EpsilonGreedy(0.3, spec=spec)).log_numerator(actor, frames, hot)
        assert found.exp().tolist() == pytest.approx([0.8])


# What could move to TorchRL


def test_the_options_of_a_strategy_are_the_arguments_of_the_base_class():
    keys = inspect.signature(BaseStrategy).parameters.keys() - {"in_keys"}
    assert Keys.__annotations__.keys() == keys
    own = inspect.signature(Strategy).parameters.keys() - {"keys"}
    assert Options.__annotations__.keys() == own | keys
    assert inspect.signature(EpsilonGreedy).parameters["options"].annotation == "Unpack[Options]"


def test_epsilon_greedy_and_softmax_need_nothing_but_their_room():
    """Of this package: the checks of arguments, and modules that import only TorchRL's world."""
    program = """
import importlib, sys, types
for name in ("trl_explore", "trl_explore.strategies"):  # without what their __init__ imports
    sys.modules[name] = types.ModuleType(name)
sys.modules["trl_explore"].__path__ = [sys.argv[1]]
sys.modules["trl_explore.strategies"].__path__ = [sys.argv[1] + "/strategies"]
importlib.import_module("trl_explore.strategies.classic")
print(*sorted(name for name in sys.modules if name.startswith("trl_explore.")))
"""
    path = inspect.getfile(EpsilonGreedy).rsplit("/", 2)[0]
    done = subprocess.run(
        [sys.executable, "-c", program, path], capture_output=True, text=True, check=True
    )
    own = "classic discrete frames mixture parameters schedules strategy worker_seeds"
    assert done.stdout.split() == [
        "trl_explore.checks", "trl_explore.strategies",
        *(f"trl_explore.strategies.{name}" for name in own.split()),
    ]  # fmt: skip
