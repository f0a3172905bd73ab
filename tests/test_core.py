"""Strategies and the loss in another project: with torch, tensordict, torchrl and numpy alone."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

LABORATORY = (
    *("numba", "llvmlite", "pandas", "matplotlib", "scipy", "statsmodels", "seaborn", "hydra"),
    *("omegaconf", "fcntl", "gymnasium", "safetensors"),
)

PROGRAM = """
import json
import sys

for name in sys.argv[1:]:
    sys.modules[name] = None  # an import of it fails

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torchrl.modules import ProbabilisticActor

import trl_explore.objectives
import trl_explore.strategies
from trl_explore.objectives import ReinforceLoss, baselines, corrections
from trl_explore.policies.actor import SoftmaxCategorical
from trl_explore.strategies import CountBonus, EpsilonGreedy, EpsilonSoftmax, Softmax

torch.manual_seed(0)
CHOICES = [
    (EpsilonGreedy(0.2), None, 0.0),
    (EpsilonSoftmax(0.2), corrections.Behaviour(), baselines.StepMean()),
    (Softmax(0.5), corrections.PerDecision(clip=2.0), baselines.LeaveOneOut()),
    (CountBonus(), corrections.Trajectory(), baselines.EpisodeMean()),
]
found = []
for strategy, correction, baseline in CHOICES:
    logits = TensorDictModule(torch.nn.Linear(3, 2), ["observation"], ["logits"])
    actor = ProbabilisticActor(
        logits, in_keys=["logits"], distribution_class=SoftmaxCategorical
    )
    loss = ReinforceLoss(
        actor, gamma=0.9, weight=1.0, correction=correction, baseline=baseline,
        strategy=strategy, functional=False,
    )
    optimizer = torch.optim.SGD(logits.parameters(), lr=0.05)
    behaviour = TensorDictSequential(logits, strategy)
    torch.nn.init.zeros_(logits.module.weight)
    torch.nn.init.zeros_(logits.module.bias)
    for _ in range(30):  # episodes of two steps, in which action 1 is rewarded
        data = TensorDict({"observation": torch.ones(40, 3), "trial": torch.zeros(40).long()}, [40])
        data = behaviour(data).detach()
        won = data["action"].float().unsqueeze(-1)
        end = torch.arange(40).unsqueeze(-1) % 2 == 1
        data["next"] = TensorDict({"reward": won, "done": end, "episode_reward": won}, [40])
        optimizer.zero_grad()
        loss.backward(data)
        optimizer.step()
        loss.step(data)
        strategy.step(data)
    learned = logits.module(torch.ones(3)).softmax(-1)[1].item()
    assert learned > 0.6, (type(strategy).__name__, learned)
    found.append(learned)

from trl_explore.policies import LaneLinear

layer = LaneLinear(torch.zeros(2, 2, 3))
layer(torch.ones(4, 3), torch.tensor([0, 0, 1, 1])).sum().backward()
assert layer.weight.grad.unique().tolist() == [2.0]
loaded = [name for name in sys.argv[1:] if sys.modules.get(name) is not None]
assert not loaded, loaded
print(json.dumps(found))
"""


def train(missing, folder):
    """π of the rewarded action after the training, for each choice."""
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", PROGRAM, *missing],
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        timeout=300,
    )
    assert run.returncode == 0, run.stderr[-2000:]
    return json.loads(run.stdout)


def test_strategies_and_the_loss_train_without_the_laboratory(tmp_path):
    plain, compiled = train(LABORATORY, tmp_path), train((), tmp_path)
    assert plain == pytest.approx(compiled, rel=1e-4)


def test_imports_compile_nothing_and_load_none_of_the_laboratory(tmp_path):
    """Not even where it is installed; torch imports some of it by itself."""
    own = [name for name in LABORATORY if name not in ("fcntl", "scipy")]
    program = (
        "import sys, torch, torchrl.modules, torchrl.objectives.common, torchrl.envs\n"
        "before = set(sys.modules)\n"
        "import trl_explore.strategies, trl_explore.objectives\n"
        f"print([n for n in {own} if n in sys.modules and n not in before])\n"
    )
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program],
        capture_output=True,
        text=True,
        check=True,
        cwd=tmp_path,
        timeout=300,
    )
    assert run.stdout == "[]\n"
