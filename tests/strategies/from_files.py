"""Every strategy over discrete actions, built from its file in conf/strategy, and frames for it."""

import numpy as np
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

from trl_explore.config import CONF
from trl_explore.config.checking import options
from trl_explore.strategies import ParameterNoise, Strategy

FILES = {
    name: OmegaConf.load(CONF / "strategy" / f"{name}.yaml")
    for name in options("strategy", "discrete")
}
BATCHES = [(), (1,), (50,), (2, 3), (2, 1, 3), (0,)]
NEVER = -torch.inf


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
