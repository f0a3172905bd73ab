"""Runs that Stable-Baselines3 really wrote: two algorithms, two seeds, two environments each."""

from __future__ import annotations

import warnings

import pytest


@pytest.fixture(scope="session")
def sb3_runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sb3")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import torch
        from stable_baselines3 import A2C, PPO
        from stable_baselines3.common.env_util import make_vec_env
        from stable_baselines3.common.logger import configure

        torch.set_num_threads(1)
        for algorithm, more in ((PPO, {"batch_size": 64, "n_epochs": 1}), (A2C, {})):
            for seed in range(2):
                run = folder / f"{algorithm.__name__}_CartPole-v1_{seed}"
                envs = make_vec_env("CartPole-v1", n_envs=2, seed=seed, monitor_dir=str(run))
                model = algorithm(
                    "MlpPolicy", envs, seed=seed, n_steps=64, device="cpu", **more
                )  # fmt: skip
                model.set_logger(configure(str(run), ["csv", "tensorboard"]))
                model.learn(600, log_interval=1)
                model.logger.close()
                envs.close()
    return folder
