"""The continuous strategies of conf/strategy, frames for them, and their densities."""

import numpy as np
import pytest
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf
from scipy import stats
from tensordict import TensorDict
from torchrl.data import Bounded
from torchrl.envs.utils import ExplorationType

from trl_explore.config import CONF
from trl_explore.config.checking import options
from trl_explore.strategies import (
    ContinuousStrategy,
)

FILES = {
    name: OmegaConf.load(CONF / "strategy" / f"{name}.yaml")
    for name in options("strategy", "continuous")
}
MODES = [ExplorationType.MODE, ExplorationType.MEAN, ExplorationType.DETERMINISTIC]
LOW, HIGH = torch.tensor([-1.0, 0.5]), torch.tensor([3.0, 0.75])
BOX = Bounded(LOW, HIGH)
LOC, SCALE = torch.tensor([0.3, 0.9]), torch.tensor([0.5, 2.0])
BOXED = ["epsilon_mean", "epsilon_uniform", "uniform_action"]

everyone = pytest.mark.parametrize("name", FILES)


def build(name, *, spec=BOX, iteration=0, **options) -> ContinuousStrategy:
    whole = {"spec": spec, "noise_key": "noise", **options}
    strategy = instantiate(FILES[name], _partial_=True, _convert_="all")(**whole)
    for _ in range(iteration):
        strategy.step()
    return strategy


def frames(n, **entries):
    return TensorDict({"loc": LOC.expand(n, 2), "scale": SCALE.expand(n, 2), **entries}, [n])


def noise_of(n, dims=2, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(n, dims + 1, generator=generator, dtype=torch.float64)


def density(name, action):
    """log mu(a) of the files' strategies at LOC and SCALE, by scipy; [n]."""
    action = np.asarray(action, dtype=np.float64)
    normal = stats.norm.pdf(action, LOC.double(), SCALE.double()).prod(-1)
    uniform = stats.uniform.pdf(action, LOW.double(), (HIGH - LOW).double()).prod(-1)
    mixed = {
        "gaussian": normal,
        "uniform_action": uniform,
        "epsilon_uniform": 0.7 * normal + 0.3 * uniform,
    }
    return np.log(mixed[name])
