"""What holds for every strategy over continuous actions, over its files in conf/strategy."""

import copy
import inspect
import io
from itertools import product

import numpy as np
import pytest
import torch
from scipy import stats
from tensordict import TensorDict
from tensordict.nn import (
    NormalParamExtractor,
    TensorDictModule,
    TensorDictModuleBase,
    TensorDictSequential,
)
from torchrl.collectors import Collector
from torchrl.data import Bounded, Categorical, Composite, MultiCategorical, OneHot, Unbounded
from torchrl.envs.libs.gym import GymEnv
from torchrl.envs.utils import set_exploration_type

from tests.strategies.continuous import (
    BOX,
    BOXED,
    FILES,
    HIGH,
    LOC,
    LOW,
    MODES,
    SCALE,
    build,
    everyone,
    frames,
    noise_of,
)
from trl_explore.strategies import (
    ContinuousStrategy,
    EpsilonMean,
    EpsilonUniform,
    Gaussian,
    MeanAction,
    Softmax,
    UniformAction,
)
from trl_explore.training.evaluation import acting


def test_the_files_are_known():
    assert {"epsilon_mean", "epsilon_uniform", "gaussian", "mean_action", "uniform_action"} <= set(
        FILES
    )


# The draw


def test_draws_by_hand():
    # Phi^-1(0.5) = 0 and Phi^-1(0.8413447...) = 1; the last number chooses: below 0.3 uniform.
    u = float(stats.norm.cdf(1.0))
    noise = torch.tensor([[0.5, u, 0.3], [0.5, u, 0.2999]], dtype=torch.float64)
    given = {"spec": BOX, "noise_key": "noise"}
    action = EpsilonUniform(0.3, **given)(frames(2, noise=noise))["action"]
    torch.testing.assert_close(action[0], torch.tensor([0.3, 2.9]))
    torch.testing.assert_close(action[1], torch.tensor([1.0, 0.5 + 0.25 * u], dtype=torch.float32))
    mean = EpsilonMean(0.3, **given)(frames(2, noise=noise))["action"]
    assert torch.equal(mean[0], LOC)
    assert torch.equal(mean[1], action[1])


def test_strategies_see_the_same_random_numbers():
    noise = noise_of(400)
    both = build("epsilon_uniform")(frames(400, noise=noise))["action"]
    uniform = build("uniform_action")(frames(400, noise=noise))["action"]
    gaussian = build("gaussian")(frames(400, noise=noise))["action"]
    explored = noise[:, 2] < 0.3
    assert torch.equal(both, torch.where(explored.unsqueeze(-1), uniform, gaussian))


@everyone
def test_the_edges_of_the_noise(name):
    for edge in (0.0, 1.0, float(np.nextafter(1, 0)), 1e-300):
        data = build(name)(frames(3, noise=torch.full((3, 3), edge, dtype=torch.float64)))
        assert data["action"].isfinite().all()
        if build(name).exact:
            assert data["action_log_prob"].isfinite().all()


@everyone
def test_noise_decides_the_draw(name):
    noise = noise_of(300)
    strategies = [build(name) for _ in range(2)]
    a, b = (strategy(frames(300, noise=noise))["action"] for strategy in strategies)
    assert torch.equal(a, b)


@everyone
def test_frames_do_not_depend_on_each_other(name):
    strategy = build(name)
    generator = torch.Generator().manual_seed(1)
    loc, noise = torch.randn(41, 2, generator=generator), noise_of(41)
    data = TensorDict({"loc": loc, "scale": loc.exp(), "noise": noise}, [41])
    together = strategy(data.clone())
    for k in range(41):
        alone = strategy(data[k : k + 1].clone())
        for key in strategy.out_keys:
            assert torch.equal(alone[key][0], together[key][k])


@everyone
def test_batch_shapes(name):
    strategy = build(name)
    assert strategy.noise_size == 3
    for batch, given in product([(), (1,), (5,), (2, 3), (0,)], (True, False)):
        entries = {"noise": torch.full((*batch, 3), 0.5)} if given else {}
        pi = {"loc": LOC.expand(*batch, 2), "scale": SCALE.expand(*batch, 2)}
        data = strategy(TensorDict({**pi, **entries}, batch))
        assert data["action"].shape == (*batch, 2)
        assert data["action"].dtype == torch.float32
        if strategy.exact:
            assert data["action_log_prob"].shape == batch
            assert data["action_log_prob"].dtype == torch.float32


@everyone
@pytest.mark.parametrize("mode", MODES, ids=str)
def test_exploration_off_takes_the_mean(name, mode):
    strategy, before = build(name), torch.get_rng_state()
    with set_exploration_type(mode):
        data = strategy(frames(4))
    assert torch.equal(data["action"], LOC.expand(4, 2))
    if strategy.exact:
        assert data["action_log_prob"].tolist() == [0.0] * 4
    assert torch.equal(torch.get_rng_state(), before)  # it draws no numbers


@everyone
def test_numbers_come_from_torchs_generator(name):
    def draw(seed):
        torch.manual_seed(seed)
        return build(name)(frames(200))["action"]

    with torch.random.fork_rng():
        assert torch.equal(draw(1), draw(1))
        assert name == "mean_action" or not torch.equal(draw(1), draw(2))


# Action specs


@everyone
def test_specs_give_box_and_size(name):
    lanes = Bounded(LOW.expand(5, 2), HIGH.expand(5, 2))
    for spec in (BOX, lanes, Composite(action=BOX), Composite(action=lanes, shape=(5,))):
        strategy = build(name, spec=spec)
        assert strategy.noise_size == 3
        assert strategy.low is not None
        assert strategy.high is not None
        assert torch.equal(strategy.low, LOW.double())
        assert torch.equal(strategy.high, HIGH.double())
        late = build(name, spec=None)
        late.set_spec(spec)
        noise = noise_of(20)
        a, b = (s(frames(20, noise=noise))["action"] for s in (strategy, late))
        assert torch.equal(a, b)


@everyone
def test_without_a_box(name):
    if name in BOXED:
        with pytest.raises(ValueError, match=r"box.*spec"):
            build(name, spec=None)(frames(3))
        with pytest.raises(ValueError, match=r"box.*finite"):
            build(name, spec=Unbounded(2))
        half = Bounded(torch.tensor([0.0, 0.0]), torch.tensor([1.0, torch.inf]))
        with pytest.raises(ValueError, match=r"box.*finite"):
            build(name, spec=half)
    else:
        for spec in (None, Unbounded(2)):
            assert build(name, spec=spec)(frames(3))["action"].shape == (3, 2)


@everyone
@pytest.mark.parametrize(
    "spec",
    [Categorical(4), OneHot(4), MultiCategorical([2, 2]), Composite(action=OneHot(4))],
    ids=lambda spec: type(spec).__name__,
)
def test_discrete_specs_are_refused(name, spec):
    cls = type(build(name)).__name__
    with pytest.raises(ValueError, match=f"{cls}.*continuous actions"):
        build(name, spec=spec)


def test_a_discrete_strategy_refuses_a_box():
    with pytest.raises(ValueError, match=r"Softmax.*discrete actions"):
        Softmax().set_spec(BOX)


def test_a_policy_of_other_dimensions_is_refused():
    with pytest.raises(ValueError, match=r"loc.*2.*3"):
        Gaussian(spec=Unbounded(3))(frames(2))


def test_keys_can_be_renamed():
    strategy = Gaussian(loc_key=("pi", "mean"), scale_key=("pi", "std"), action_key="move")
    assert strategy.in_keys == [("pi", "mean"), ("pi", "std")]
    assert strategy.out_keys == ["move", "move_log_prob"]
    data = strategy(TensorDict({"pi": {"mean": LOC, "std": SCALE}}))
    assert data["move"].shape == (2,)


@everyone
def test_who_exploits_reads_and_writes_the_same_entries(name):
    strategy = build(name, loc_key="mean", scale_key="deviation", action_key="torque")
    data = TensorDict({"mean": LOC, "deviation": SCALE})
    assert torch.equal(acting(strategy, "greedy")(data)["torque"], LOC)


def test_the_agents_of_a_group_have_their_own_boxes():
    low = torch.tensor([[-1.0, -1.0], [5.0, 5.0]])
    spec = Composite(agents=Composite(action=Bounded(low, low + 2), shape=(2,)))
    strategy = UniformAction(spec=spec, loc_key=("agents", "loc"), action_key=("agents", "action"))
    group = TensorDict({"loc": torch.zeros(400, 2, 2)}, [400, 2])
    data = strategy(TensorDict({"agents": group}, [400]))["agents"]
    for k in range(2):
        action = data["action"][:, k]
        assert ((low[k] <= action) & (action <= low[k] + 2)).all()
        assert (action.amax(0) - action.amin(0) > 1.9).all()
    assert data["action_log_prob"].shape == (400, 2)
    np.testing.assert_allclose(data["action_log_prob"], -np.log(4), rtol=1e-6)


@pytest.mark.parametrize("cls", [MeanAction, UniformAction, EpsilonMean])
def test_a_deterministic_actor_has_no_scale(cls):
    data = cls(spec=BOX, loc_key="action")(TensorDict({"action": LOC.expand(50, 2)}, [50]))
    assert data["action"].shape == (50, 2)


# State and parameters


@everyone
def test_state_dict_round_trip(name):
    first = build(name, iteration=7)
    file = io.BytesIO()
    torch.save(first.state_dict(), file)
    file.seek(0)
    second = build(name)
    second.load_state_dict(torch.load(file, weights_only=True))
    assert second.iteration == 7
    noise = noise_of(20)
    a, b = (strategy(frames(20, noise=noise))["action"] for strategy in (first, second))
    assert torch.equal(a, b)


@everyone
def test_copies_are_independent(name):
    original = build(name)
    twin = copy.deepcopy(original)
    original.step()
    assert (original.iteration, twin.iteration) == (1, 0)


@everyone
def test_every_argument_of_its_own_stands_in_the_file(name):
    own = inspect.signature(type(build(name))).parameters.values()
    named = {p.name for p in own if p.kind is not inspect.Parameter.VAR_KEYWORD}
    shared = set(inspect.signature(ContinuousStrategy).parameters)
    assert set(FILES[name]) - {"_target_"} == named - shared


@pytest.mark.parametrize(
    ("name", "key"),
    [("gaussian", "temperature"), ("epsilon_uniform", "epsilon"), ("epsilon_mean", "epsilon")],
)
def test_parameters_per_trial(name, key):
    values = [0.9, 0.3, 1.0]
    strategy = build(name, **{key: values})
    strategy.bind(TensorDictModuleBase(), 3)
    trial, noise = torch.arange(30) % 3, noise_of(30)
    data = strategy(frames(30, trial=trial, noise=noise))
    for k, own in enumerate(values):
        mine = trial == k
        alone = build(name, **{key: own})(frames(10, noise=noise[mine]))
        for entry in strategy.out_keys:
            assert torch.equal(data[entry][mine], alone[entry])
    with pytest.raises(ValueError, match=r"3 values.*4 trials"):
        strategy.bind(TensorDictModuleBase(), 4)
    with pytest.raises(ValueError, match="'trial'"):
        strategy(frames(30, noise=noise))


@pytest.mark.parametrize("bad", [float("nan"), -1.0])
@everyone
def test_numbers_that_make_no_sense_are_refused(name, bad):
    for key in set(FILES[name]) - {"_target_"}:
        with pytest.raises(ValueError, match=rf"{key}\b"):
            build(name, **{key: bad})


# In a project that knows nothing of this one


@everyone
def test_behind_a_network_in_torchrls_collector(name):
    env = GymEnv("Pendulum-v1")
    env.set_seed(0)
    network = torch.nn.Sequential(torch.nn.Linear(3, 2), NormalParamExtractor())
    policy = TensorDictModule(network, ["observation"], ["loc", "scale"])
    strategy = build(name, spec=env.action_spec)
    collector = Collector(
        env, TensorDictSequential(policy, strategy), frames_per_batch=60, total_frames=60,
        auto_register_policy_transforms=True,
    )  # fmt: skip
    (data,) = (batch.clone() for batch in collector)
    collector.shutdown()
    assert data["action"].shape == (60, 1)
    if strategy.exact:
        own = strategy.log_prob(data["action"], data["loc"], data["scale"])
        torch.testing.assert_close(data["action_log_prob"], own, rtol=1e-4, atol=1e-5)
