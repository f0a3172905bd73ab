"""The tasks for exploration: class and kernel agree; the best return is computed by hand."""

from __future__ import annotations

import math
from functools import cache
from itertools import product
from typing import Any, cast

import gymnasium as gym
import numpy as np
import pytest

from trl_explore.envs import NAMESPACE, TASKS
from trl_explore.envs.kernels import CompiledEnv, check_kernel, kernel_of
from trl_explore.envs.kernels.bsuite import Catch, DeepSea
from trl_explore.envs.kernels.classic_control import SparseMountainCar
from trl_explore.envs.kernels.swing_up import SwingUp
from trl_explore.envs.kernels.tables import RiverSwim, TwoRooms
from trl_explore.numerics.streams import Stream, generator

CASES = [  # the environment, and how many of 200 episodes of at most 60 steps terminate
    (lambda: DeepSea(10), 200),
    (lambda: DeepSea(50), 200),
    (lambda: DeepSea(2, stochastic=True), 200),
    (lambda: DeepSea(9, stochastic=True, mapping_seed=None), 200),
    (lambda: RiverSwim(), 0),
    (lambda: RiverSwim(3), 0),
    (lambda: TwoRooms(2), 20),
    (lambda: TwoRooms(3, slip=0.4), 20),
    (lambda: Catch(), 200),
    (lambda: Catch(rows=2, columns=1), 200),
    (lambda: SwingUp(), 0),
    (lambda: SparseMountainCar(), 0),
]


@pytest.mark.parametrize(("make", "ends"), CASES)
def test_every_transition_is_that_of_the_class(make, ends):
    transitions, found = check_kernel(make(), episodes=200, max_steps=60)
    assert transitions >= 200
    assert found >= ends


def play(env, policy, episodes=1):
    """Returns of the class and of the kernel in the same episodes [episodes]."""
    compiled, theirs, ours = CompiledEnv(kernel_of(env), seed=5), [], []
    for episode in range(episodes):
        env.np_random = generator(5, Stream.ENVIRONMENT, 0, episode)
        env.reset()
        compiled.begin(episode)
        scores, over = [0.0, 0.0], False
        while not over:
            action = policy(env)
            _, reward, over, _, _ = env.step(action)
            _, our_reward, ended = compiled.step(action)
            assert ended == over
            scores[0] += reward
            scores[1] += our_reward
        theirs.append(scores[0])
        ours.append(scores[1])
    return np.array(theirs), np.array(ours)


def best_of_deep_sea(size: int, stochastic: bool) -> float:
    """The optimal mean return of DeepSea by dynamic programming, from bsuite's rules."""
    fails = 1 / size if stochastic else 0.0

    @cache
    def value(row: int, column: int) -> float:
        if row == size:
            return 0.0
        left = value(row + 1, max(column - 1, 0))
        moved, stayed = value(row + 1, min(column + 1, size - 1)), value(row + 1, column)
        earned = float(column == size - 1) - 0.01 / size
        return max(left, earned + (1 - fails) * moved + fails * stayed)

    return value(0, 0)


@pytest.mark.parametrize("size", [2, 10, 30, 50])
def test_the_best_return_of_deep_sea(size):
    assert best_of_deep_sea(size, False) == pytest.approx(0.99)
    for seed in (0, 7, None):
        env = DeepSea(size, mapping_seed=seed)
        for score in play(env, lambda env: env.right[env.row, env.column]):
            assert score == pytest.approx(0.99)


@pytest.mark.parametrize("size", [3, 10])
def test_the_best_return_of_stochastic_deep_sea(size):
    """Always going right is what bsuite calls optimal; a failed agent can save the cost."""
    always = (1 - 1 / size) ** (size - 1) - 0.01
    best = best_of_deep_sea(size, True)
    assert always < best < always + 0.01
    env = DeepSea(size, stochastic=True)
    theirs, ours = play(env, lambda env: env.right[env.row, env.column], episodes=4000)
    np.testing.assert_array_equal(ours, theirs)
    assert abs(ours.mean() - always) < 4 * ours.std() / math.sqrt(4000)


def test_one_of_all_sequences_of_actions_has_the_reward():
    env, rewarded = DeepSea(6), []
    for actions in product((0, 1), repeat=6):
        env.reset(seed=0)
        rewarded.append(sum(env.step(action)[1] for action in actions) > 0)
    assert sum(rewarded) == 1
    assert best_of_deep_sea(6, False) > 0


def test_noise_of_the_end_states_is_standard_normal():
    from scipy.stats import kstest

    env = DeepSea(2, stochastic=True, mapping_seed=None)  # left, left: the noise alone
    theirs, _ = play(env, lambda env: 0, episodes=2000)
    assert kstest(theirs, "norm").pvalue > 1e-3


def test_the_mapping_is_the_same_for_all_trials_and_differs_between_seeds():
    assert (DeepSea(20).right == DeepSea(20).right).all()
    assert 0.3 < (DeepSea(20).right != DeepSea(20, mapping_seed=1).right).mean() < 0.7
    assert (DeepSea(20, mapping_seed=None).right == 1).all()


def test_river_swim_by_backward_induction():
    """From the rules alone: right 0.35, stay 0.6, left 0.05; at the ends 0.6/0.4 and 0.4/0.6."""
    size, value = 6, [0.0] * 6
    for _ in range(20):
        old, last = value, size - 1
        value = [
            max(0.005 + old[0], 0.4 * old[0] + 0.6 * old[1]),
            *(
                max(old[s - 1], 0.05 * old[s - 1] + 0.6 * old[s] + 0.35 * old[s + 1])
                for s in range(1, last)
            ),
            max(old[last - 1], 1 + 0.4 * old[last - 1] + 0.6 * old[last]),
        ]
    assert value[0] == pytest.approx(3.397, abs=5e-4)
    compiled, scores = CompiledEnv(kernel_of(RiverSwim()), seed=2), []
    for episode in range(4000):  # swimming right is optimal until the time is short
        compiled.begin(episode)
        scores.append(sum(compiled.step(1)[1] for _ in range(20)))
    assert abs(np.mean(scores) - value[0]) < 4 * np.std(scores) / math.sqrt(4000) + 0.01


@pytest.mark.parametrize("size", [2, 3, 5, 8])
def test_the_shortest_way_through_the_door(size):
    env = TwoRooms(size)
    near, steps = {0}, 0
    while env.goal not in near:
        near = near | {env.P[s][a][0][1] for s in near for a in range(4)}
        steps += 1
    assert steps == 3 * size - 1
    door, last = size // 2, size - 1
    way = iter([2] * door + [1] * 2 * size + [2] * (last - door))
    theirs, ours = play(env, lambda env: next(way))
    assert theirs.tolist() == ours.tolist() == [1.0]
    with pytest.raises(StopIteration):
        next(way)


def test_a_slip_goes_in_each_other_direction():
    outcomes = {s: p for p, s, _, _ in TwoRooms(5, slip=0.3).P[12][1]}  # row 1, column 1
    assert outcomes == pytest.approx({13: 0.7, 1: 0.1, 11: 0.1, 23: 0.1})


def test_catch_is_won_by_following_the_ball():
    def follow(env):
        return 1 + int(np.sign(env.column - env.paddle))

    theirs, ours = play(Catch(), follow, episodes=50)
    assert theirs.tolist() == ours.tolist() == [1.0] * 50
    theirs, _ = play(Catch(), lambda env: 1, episodes=2000)  # the ball comes by chance in 1 of 5
    assert theirs.mean() == pytest.approx(-0.6, abs=0.08)


def test_the_pendulum_is_gymnasiums():
    theirs: Any = gym.make("Pendulum-v1").unwrapped
    theirs.reset(seed=0)
    env = SwingUp()
    env.reset(seed=0)
    theirs.state = np.array([env.theta, env.speed])
    draws = np.random.default_rng(1)
    for _ in range(200):
        action = int(draws.integers(3))
        theirs.step(np.array([2.0 * (action - 1)]))
        env.step(action)
        np.testing.assert_allclose([env.theta, env.speed], theirs.state, rtol=1e-9, atol=1e-9)


def test_a_pendulum_swung_by_its_energy_comes_up():
    """Push with the motion until the energy suffices, then hold; doing nothing returns 0."""

    def control(env):
        energy = env.speed**2 / 6 + 5 * math.cos(env.theta)
        if math.cos(env.theta) < 0.9:
            return 2 if (env.speed > 0) == (energy < 5) else 0
        angle = (env.theta + math.pi) % (2 * math.pi) - math.pi
        push = -10 * angle - 2.5 * env.speed
        return 1 if abs(push) < 0.6 else 1 + int(np.sign(push))

    env = SwingUp()
    env.reset(seed=3)
    assert sum(env.step(control(env))[1] for _ in range(200)) > 120
    env.reset(seed=3)
    assert sum(env.step(1)[1] for _ in range(200)) == 0
    env.reset(seed=3)
    assert sum(env.step(2)[1] for _ in range(10)) == pytest.approx(-1.0)


def test_the_sparse_car_earns_at_the_goal_alone():
    env, dense = SparseMountainCar(), gym.make("MountainCar-v0").unwrapped
    env.reset(seed=4)
    dense.reset(seed=4)
    compiled = CompiledEnv(kernel_of(env))
    compiled.state[:] = env.state
    rewards, over = [], False
    while not over:
        action = 2 if env.state[1] >= 0 else 0  # push with the motion
        expected = dense.step(action)
        observation, reward, over, _, _ = env.step(action)
        ours, our_reward, ended = compiled.step(action)
        assert (ours == observation).all()
        assert (observation == expected[0]).all()
        assert (reward, over) == (our_reward, ended)
        assert over == expected[2]
        rewards.append(reward)
    assert rewards == [0.0] * (len(rewards) - 1) + [1.0]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: DeepSea(1), "size.*>= 2, got 1"),
        (lambda: DeepSea(101), "size.*<= 100, got 101"),
        (lambda: DeepSea(5, stochastic=cast(Any, "yes")), "stochastic"),
        (lambda: DeepSea(5, mapping_seed=-1), "mapping_seed"),
        (lambda: RiverSwim(2), "size"),
        (lambda: TwoRooms(5, slip=1.5), "slip"),
        (lambda: Catch(rows=1), "rows"),
        (lambda: SwingUp(move_cost=-1), "move_cost"),
    ],
)
def test_arguments_out_of_range_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_every_task_is_registered():
    for name, (place, steps, threshold) in TASKS.items():
        spec = gym.spec(f"{NAMESPACE}/{name}")
        assert (spec.max_episode_steps, spec.reward_threshold) == (steps, threshold)
        assert type(gym.make(spec.id).unwrapped).__name__ == place.split(":")[1]
