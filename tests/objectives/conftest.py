import pytest

from tests.objectives.mdp import MDP
from trl_explore.envs import make_env


@pytest.fixture(scope="module")
def env():
    env = make_env("CartPole-v1", trials=30)
    yield env
    env.close()


@pytest.fixture(params=range(3), scope="module")
def mdp(request):
    return MDP(request.param)
