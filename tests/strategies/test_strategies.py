"""What holds for every strategy over discrete actions, over its files in conf/strategy."""

import copy
import io
import pickle
from collections.abc import Sequence
from itertools import product

import numpy as np
import pytest
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf
from scipy import stats
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torchrl.collectors import Collector
from torchrl.data import Categorical, Composite, OneHot
from torchrl.envs.libs.gym import GymEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type

from trl_explore.config import CONF
from trl_explore.config.checking import options
from trl_explore.strategies import ParameterNoise, Strategy
from trl_explore.training.evaluation import acting

FILES = {
    name: OmegaConf.load(CONF / "strategy" / f"{name}.yaml")
    for name in options("strategy", "discrete")
}
ARGMAX = [ExplorationType.MODE, ExplorationType.MEAN, ExplorationType.DETERMINISTIC]
BATCHES = [(), (1,), (50,), (2, 3), (2, 1, 3), (0,)]
NEVER = -torch.inf
QUIET = {"auto_register_policy_transforms": True}  # torchrl 0.14 warns where it is not stated

pytestmark = pytest.mark.parametrize("name", FILES)


class Scaled(torch.nn.Module):
    """A target policy with one parameter for each trial, which is 1."""

    def __init__(self, trials):
        super().__init__()
        self.scale = torch.nn.Parameter(torch.ones(trials))

    def forward(self, preferences, trial=None):
        return preferences * (self.scale if trial is None else self.scale[trial].unsqueeze(-1))


def target(trials) -> TensorDictModule:
    return TensorDictModule(Scaled(trials), ["preferences", "trial"], ["logits"])


def unbound(name, **options) -> Strategy:
    return instantiate(FILES[name], _partial_=True, _convert_="all")(**options)


def build(name, *, iteration=0, trials=1, first_trial=0, **options) -> Strategy:
    strategy = unbound(name, noise_key="noise", **options)
    strategy.bind(target(trials), trials, seed=0, first_trial=first_trial)
    strategy.begin(np.ones(trials, dtype=np.bool_), np.zeros(trials, dtype=np.int64))
    for _ in range(iteration):
        strategy.step()
    return strategy


def standalone(name, policy, **options) -> Strategy:
    """For whoever calls no hook; only a strategy that perturbs parameters must know them."""
    strategy = unbound(name, **options)
    if isinstance(strategy, ParameterNoise):
        strategy.bind(policy, 1)
    return strategy


def numbers(name) -> Sequence[str]:
    return [key for key, value in FILES[name].items() if isinstance(value, int | float)]


def logits_of(*batch, n=4, seed=0):
    return 2 * torch.randn(*batch, n, generator=torch.Generator().manual_seed(seed))


def frames(logits, **entries):
    """Frames of one observation; the logits are those of ``target``."""
    batch = logits.shape[:-1]
    features = {"observation": torch.ones(*batch, 3), "preferences": logits}
    return TensorDict({"logits": logits, **features, **entries}, batch)


def uniforms(strategy, *batch, seed=1):
    """As much noise as the strategy uses."""
    shape = batch if strategy.noise_size == 1 else (*batch, strategy.noise_size)
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def drawn(module, data):
    """A copy of the data with the actions that are drawn from one state of torch's generator."""
    torch.manual_seed(0)
    return module(data.clone())


def mu(strategy, data, logits=None):
    """What the strategy says that it does in these frames."""
    logits = data["logits"] if logits is None else logits
    if "action_mask" in data:
        logits = logits.masked_fill(~data["action_mask"], NEVER)
    return strategy.probs(strategy.preferences(data, logits), data.get("trial", None))


def assert_log_prob(strategy, data, probs):
    """The log-probability is that of the drawn action, or there is none."""
    if not strategy.exact:
        assert "action_log_prob" not in data
        assert "action_log_prob" not in strategy.out_keys
        return
    of_action = probs.gather(-1, data["action"].unsqueeze(-1)).squeeze(-1)
    assert torch.equal(data["action_log_prob"], of_action.log())
    assert data["action_log_prob"].isfinite().all()


# The distribution


@pytest.mark.parametrize("iteration", [0, 60])
def test_probs_are_a_distribution(name, iteration):
    strategy = build(name, iteration=iteration)
    for batch, n in product(BATCHES, (1, 2, 9)):
        logits = logits_of(*batch, n=n)
        before = logits.clone()
        probs = strategy.probs(logits)
        assert probs.shape == logits.shape
        assert probs.dtype == logits.dtype
        assert (probs >= 0).all()
        torch.testing.assert_close(probs.sum(-1), torch.ones(batch))
        assert torch.equal(logits, before)


@pytest.mark.parametrize("iteration", [0, 60])
def test_a_logit_of_minus_infinity_gets_nothing(name, iteration):
    logits = torch.tensor(
        [[NEVER, 1.0, 2.0, 2.0], [0.5, NEVER, NEVER, 1.0], [NEVER, NEVER, 0, NEVER]]
    )
    strategy = build(name, iteration=iteration)
    probs = strategy.probs(logits)
    assert (probs[logits == NEVER] == 0).all()
    torch.testing.assert_close(probs.sum(-1), torch.ones(3))
    # What is forbidden might as well not be there.
    torch.testing.assert_close(probs[1, [0, 3]], strategy.probs(logits[1, [0, 3]]))
    assert probs[2].tolist() == [0, 0, 1, 0]


def test_frames_do_not_depend_on_each_other(name):
    strategy = build(name, iteration=60)
    logits = logits_of(6)
    together = strategy.probs(logits)
    for row in range(6):
        assert torch.equal(strategy.probs(logits[row]), together[row])


def test_equal_preferences_are_equally_likely(name):
    probs = build(name, iteration=60).probs(torch.tensor([1.0, 3.0, 1.0, 3.0]))
    assert probs[0] == probs[2]
    assert probs[1] == probs[3]
    assert probs[1] >= probs[0]


# The draw


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_log_prob_is_that_of_the_drawn_action(name, dtype):
    strategy = build(name, iteration=60)
    data = strategy(frames(logits_of(300).to(dtype)))
    assert_log_prob(strategy, data, mu(strategy, data))
    if strategy.exact:
        assert data["action_log_prob"].dtype == dtype
        assert data["action_log_prob"].shape == (300,)


@pytest.mark.parametrize("iteration", [0, 60])
@pytest.mark.parametrize("mode", [ExplorationType.RANDOM, None])
def test_frequencies_are_the_probabilities(name, iteration, mode):
    torch.manual_seed(3)
    strategy = build(name, iteration=iteration)
    logits = torch.tensor([0.0, 1.0, NEVER, 0.8, 1.0], dtype=torch.float64)
    with set_exploration_type(mode):
        data = strategy(frames(logits.expand(20_000, 5)))
    counts = np.bincount(data["action"].numpy(), minlength=5)
    expected = 20_000 * mu(strategy, data)[0].numpy()
    possible = expected > 0
    assert counts[~possible].sum() == 0
    if possible.sum() > 1:
        assert stats.chisquare(counts[possible], expected[possible]).pvalue > 1e-3


def test_a_strategy_explores_unless_told_otherwise(name):
    actions = build(name)(frames(torch.zeros(400, 4)))["action"]
    assert len(actions.unique()) == 4


@pytest.mark.parametrize("mode", ARGMAX, ids=str)
def test_exploration_off_takes_the_argmax(name, mode):
    logits = torch.cat(
        [logits_of(100), torch.tensor([[1.0, 3.0, 2.0, 3.0], [NEVER, 0.0, 0.0, -1.0]])]
    )
    strategy = build(name)
    with set_exploration_type(mode):
        data = strategy(frames(logits, noise=uniforms(strategy, 102)))
        assert torch.equal(data["action"], torch.from_numpy(logits.numpy().argmax(-1)))
        if strategy.exact:
            assert data["action_log_prob"].tolist() == [0.0] * 102
        mask = torch.ones(102, 4, dtype=torch.bool)
        mask[:, 1] = False
        masked = strategy(frames(logits, action_mask=mask))["action"]
        assert torch.equal(masked, logits[:, [0, 2, 3]].argmax(-1).apply_(lambda k: (0, 2, 3)[k]))


def test_who_exploits_reads_and_writes_the_same_entries(name):
    keys = {"logits_key": "value", "action_key": "move", "action_mask_key": "legal"}
    greedy = acting(build(name, spec=OneHot(4), **keys), "greedy")
    legal = torch.tensor([[False, True, True, True]])
    data = TensorDict({"value": torch.tensor([[5.0, 0, 3, 1]]), "legal": legal}, [1])
    assert greedy(data)["move"].tolist() == [[False, False, True, False]]


def test_exploration_off_draws_no_numbers(name):
    before = torch.get_rng_state()
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        build(name)(frames(torch.zeros(50, 4)))
    assert torch.equal(torch.get_rng_state(), before)


@pytest.mark.parametrize("iteration", [0, 60])
def test_noise_decides_the_draw(name, iteration):
    logits = torch.cat([logits_of(300), torch.zeros(300, 4)])
    strategies = [build(name, iteration=iteration) for _ in range(2)]
    noise = uniforms(strategies[0], 600)
    a, b = (strategy(frames(logits, noise=noise))["action"] for strategy in strategies)
    assert torch.equal(a, b)
    if type(strategies[0]).explore is not Strategy.explore:
        return  # it uses the noise in a way of its own
    cdf = mu(strategies[0], frames(logits)).double().numpy().cumsum(-1)
    for row in range(600):
        at = noise[row].item() * cdf[row, -1]
        assert a[row] == np.searchsorted(cdf[row], at, side="right")


def test_batch_shapes(name):
    strategy = build(name)
    for batch, given in product(BATCHES, (True, False)):
        entries = {"noise": uniforms(strategy, *batch)} if given else {}
        data = strategy(frames(logits_of(*batch), **entries))
        assert data["action"].shape == batch
        assert data["action"].dtype == torch.int64
        if strategy.exact:
            assert data["action_log_prob"].shape == batch


# Masks


@pytest.mark.parametrize("iteration", [0, 60])
def test_mask_is_obeyed(name, iteration):
    generator = torch.Generator().manual_seed(5)
    logits = logits_of(500)
    mask = torch.rand(500, 4, generator=generator) < 0.4
    mask[torch.arange(500), torch.randint(4, (500,), generator=generator)] = True
    strategy = build(name, iteration=iteration)
    data = strategy(frames(logits, action_mask=mask))
    assert mask.gather(-1, data["action"].unsqueeze(-1)).all()
    probs = mu(strategy, data)
    assert (probs[~mask] == 0).all()
    assert_log_prob(strategy, data, probs)
    assert torch.equal(data["logits"], logits)
    assert torch.equal(data["logits"], logits_of(500))


def test_mask_that_allows_everything_changes_nothing(name):
    logits, mask = logits_of(100), torch.ones(100, 4, dtype=torch.bool)
    plain = drawn(build(name), frames(logits))
    masked = drawn(build(name), frames(logits, action_mask=mask))
    assert torch.equal(plain["action"], masked["action"])
    if build(name).exact:
        assert torch.equal(plain["action_log_prob"], masked["action_log_prob"])


def test_mask_that_forbids_everything_is_an_error(name):
    mask = torch.tensor([[True, False, False, False], [False] * 4])
    with pytest.raises(ValueError, match="action mask"):
        build(name)(frames(logits_of(2), action_mask=mask))


# Action specs


@pytest.mark.parametrize("composite", [False, True])
def test_one_hot_and_categorical_actions_are_the_same(name, composite):
    actions = {}
    for spec in (Categorical(4), OneHot(4)):
        strategy = build(name, spec=Composite(action=spec) if composite else spec)
        data = strategy(frames(logits_of(100), noise=uniforms(strategy, 100)))
        actions[type(spec)] = data["action"]
        assert data["action"].dtype == spec.dtype
        assert spec.expand(*data.batch_size, *spec.shape).is_in(data["action"])
        if strategy.exact:
            assert data["action_log_prob"].shape == (100,)
    assert torch.equal(actions[OneHot].int().argmax(-1), actions[Categorical])
    assert (actions[OneHot].sum(-1) == 1).all()


# State


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


# Configuration and parameters


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


# In a project that knows nothing of this one


@pytest.mark.parametrize("indices", [True, False], ids=["categorical", "one_hot"])
def test_behind_a_q_network_in_torchrls_collector(name, indices):
    env = GymEnv("CartPole-v1", categorical_action_encoding=indices)
    env.set_seed(0)
    torch.manual_seed(1)  # other weights may balance the pole for longer than a batch
    q = TensorDictModule(torch.nn.Linear(4, 2), ["observation"], ["action_value"])
    strategy = standalone(name, q, spec=env.action_spec, logits_key="action_value")
    collector = Collector(
        env, TensorDictSequential(q, strategy), frames_per_batch=60, total_frames=120, **QUIET
    )
    batches = []
    for batch in collector:
        data = batch.clone()
        batches.append(data)
        assert data.batch_size == (60,)
        action = data["action"] if indices else data["action"].int().argmax(-1)
        assert data["action"].shape == ((60,) if indices else (60, 2))
        assert env.action_spec.expand(60, *env.action_spec.shape).is_in(data["action"])
        if strategy.exact and not isinstance(strategy, ParameterNoise):
            last = int(data["is_init"].nonzero()[-1, 0])  # of its episode all frames are here
            episode = data[last:].exclude("is_init")
            probs = mu(strategy, episode, episode["action_value"])
            of_action = probs.gather(-1, action[last:].unsqueeze(-1)).squeeze(-1)
            torch.testing.assert_close(episode["action_log_prob"], of_action.log())
        # The action is the one that the environment took: pushing right speeds up.
        falling = data["next", "observation"][:, 1] - data["observation"][:, 1]
        assert torch.equal(falling > 0, action == 1)
        strategy.step()
    collector.shutdown()
    assert len(batches) == 2
    assert int(strategy.iteration) == 2


def test_evaluation_in_torchrls_collector(name):
    env = GymEnv("CartPole-v1", categorical_action_encoding=True)
    env.set_seed(0)
    q = TensorDictModule(torch.nn.Linear(4, 2), ["observation"], ["action_value"])
    policy = TensorDictSequential(q, standalone(name, q, logits_key="action_value"))
    collector = Collector(
        env,
        policy,
        frames_per_batch=40,
        total_frames=40,
        exploration_type=ExplorationType.DETERMINISTIC,
        **QUIET,
    )
    for data in collector:
        assert torch.equal(data["action"], data["action_value"].argmax(-1))
    collector.shutdown()
