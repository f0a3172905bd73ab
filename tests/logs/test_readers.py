"""Every reader, on files that the real program wrote wherever it can be run here."""

from __future__ import annotations

import json
import warnings

import numpy as np
import pandas as pd
import pytest

from trl_explore.jobs.files import ResultsError
from trl_explore.logs.readers import READERS, read_runs


def described(runs):
    return [(r.configuration, r.environment, r.seed) for r in runs]


SB3 = [(name, "CartPole-v1", seed) for name in ("A2C", "PPO") for seed in (0, 1)]


def test_sb3_monitors_are_merged_in_the_order_of_their_ends(sb3_runs):
    from stable_baselines3.common.monitor import load_results

    runs, _ = read_runs("sb3", [sb3_runs])
    assert described(runs) == SB3
    for run in runs:
        theirs = load_results(str(sb3_runs.parent / run.place))  # sorted by time, as SB3 plots them
        assert run.curve.score.tolist() == theirs["r"].tolist()
        assert run.curve.step.tolist() == theirs["l"].cumsum().tolist()
        assert run.notes == ("2 environments",)
        assert run.episodes


def test_sb3_event_files_and_progress_agree(sb3_runs, tmp_path):
    events, others = read_runs("tensorboard", [sb3_runs])
    assert described(events) == SB3
    assert "train/learning_rate" in others
    for run in events:
        copy = tmp_path / run.place
        copy.mkdir(parents=True)
        file = sb3_runs.parent / run.place / "progress.csv"
        (copy / "progress.csv").write_bytes(file.read_bytes())
    rows, _ = read_runs("sb3", [tmp_path / sb3_runs.name])
    for run, row in zip(events, rows, strict=True):
        assert run.score == row.score == "rollout/ep_rew_mean"
        assert run.curve.step.tolist() == row.curve.step.tolist() == [128 * k for k in range(1, 6)]
        np.testing.assert_allclose(run.curve.score, row.curve.score, rtol=1e-6)


def test_several_sb3_runs_in_one_folder_and_a_continued_one(tmp_path):
    import gymnasium
    from stable_baselines3.common.monitor import Monitor

    for part in range(2):
        for seed in (3, 4):
            env = Monitor(
                gymnasium.make("CartPole-v1"), str(tmp_path / f"ppo_seed{seed}"),
                override_existing=part == 0,
            )  # fmt: skip
            for episode in range(40 if part == 0 else 2):
                env.reset(seed=10 * part + episode)
                while not np.any(env.step(0)[2:4]):
                    pass
            env.close()
    runs, _ = read_runs("sb3", [tmp_path])
    assert described(runs) == [("ppo", "CartPole-v1", 3), ("ppo", "CartPole-v1", 4)]
    for run in runs:
        assert len(run.curve) == 42
        assert run.curve.step[-1] == run.curve.score.sum()  # one point of score for each step
        assert run.notes == ("continued in one file",)


@pytest.mark.parametrize("text", ["", "\0\1", '#{"t_start": 1.0}\n', '#{"t_start": 1.0}\nr,l,t\n'])
def test_an_sb3_run_without_episodes_is_left_out_and_named(tmp_path, text):
    for name, content in (("1", text), ("2", '#{"t_start": 1.0}\nr,l,t\n9.0,9,0.1\n')):
        (tmp_path / name).mkdir()
        (tmp_path / name / "monitor.csv").write_text(content)
    (first, second), _ = read_runs("sb3", [tmp_path])
    assert (first.used, second.used) == (False, True)
    assert "no episodes in monitor.csv" in first.notes


def test_torchrl_csv_logger(tmp_path):
    from torchrl.record.loggers import generate_exp_name
    from torchrl.record.loggers.csv import CSVLogger

    for seed in range(2):
        (tmp_path / str(seed) / ".hydra").mkdir(parents=True)
        record = tmp_path / str(seed) / ".hydra"
        (record / "overrides.yaml").write_text(f"- optim.lr=0.1\n- seed={seed}\n")
        (record / "config.yaml").write_text(f"seed: {seed}\nenv:\n  env_name: HalfCheetah-v4\n")
        name = generate_exp_name("PPO", "first")
        logger = CSVLogger(name, log_dir=str(tmp_path / str(seed)))
        for step in (100, 200, 300):
            logger.log_scalar("train/reward", step / (seed + 1), step=step)
            logger.log_scalar("eval/reward", 1.0, step=step)
        for file in logger.experiment.files.values():
            file.close()
    runs, others = read_runs("torchrl", [tmp_path])
    assert [(r.environment, r.seed) for r in runs] == [("HalfCheetah-v4", 0), ("HalfCheetah-v4", 1)]
    assert runs[0].configuration == runs[1].configuration
    assert runs[1].curve.step.tolist() == [100, 200, 300]
    assert runs[1].curve.score.tolist() == [50, 100, 150]
    assert runs[0].score == "train/reward"
    assert others == ["eval/reward"]
    runs, _ = read_runs("torchrl", [tmp_path], columns={"score": "eval/reward"})
    assert runs[0].curve.score.tolist() == [1, 1, 1]


def test_cleanrl_event_files_with_a_restart_and_duplicates(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from torch.utils.tensorboard import SummaryWriter

    for seed, points in ((1, [(10, 1.0), (10, 3.0), (30, 5.0)]), (2, [(20, 2.0), (40, 4.0)])):
        for name in ("ppo", "dqn"):
            run = tmp_path / f"CartPole-v1__{name}__{seed}__17000000{seed:02d}"
            with SummaryWriter(str(run)) as writer:
                writer.add_text("hyperparameters", "lr")
                for step, value in points:
                    writer.add_scalar("charts/episodic_return", value, step)
                    writer.add_scalar("charts/SPS", 100.0, step)
    with SummaryWriter(str(tmp_path / "CartPole-v1__ppo__2__1700000002")) as writer:
        for step, value in ((30, 7.0), (50, np.nan), (60, 8.0)):  # continued from step 20
            writer.add_scalar("charts/episodic_return", value, step)
    runs, others = read_runs("cleanrl", [tmp_path])
    assert described(runs) == [(c, "CartPole-v1", s) for c in ("dqn", "ppo") for s in (1, 2)]
    assert runs[0].curve.score.tolist() == [1, 3, 5]  # both episodes that ended at step 10
    assert runs[3].curve.step.tolist() == [20, 30, 60]
    assert runs[3].curve.score.tolist() == [2, 7, 8]
    assert runs[3].notes == (
        "2 event files", "restarted 1 time, 1 point replaced", "1 value not finite, left out",
    )  # fmt: skip
    assert others == ["charts/SPS"]


def test_a_wandb_export(tmp_path):
    rows = [
        ["Step", "ppo_seed1 - episodic_return", "ppo_seed1 - episodic_return__MIN",
         "a2c_seed1 - episodic_return", "a2c_seed1 - _step"],
        [10, 1.5, 1.5, "", 10],
        [20, "", "", 2.5, 20],
        [30, 3.5, 3.5, "NaN", 30],
    ]  # fmt: skip
    file = tmp_path / "wandb_export.csv"
    file.write_text("\n".join(",".join(f'"{x}"' for x in row) for row in rows))
    runs, _ = read_runs("wandb", [file])
    assert described(runs) == [("ppo", "", 1), ("a2c", "", 1)]
    assert runs[0].curve.step.tolist() == [10, 30]
    assert runs[1].curve.step.tolist() == [20]
    assert runs[1].notes == ("1 value not finite, left out",)
    file.write_text("Name,State\nrun,finished\n")
    with pytest.raises(ResultsError, match="RUN - QUANTITY"):
        read_runs("wandb", [file])


def test_rllib_progress(tmp_path):
    for seed in (0, 7):
        run = tmp_path / f"PPO_CartPole-v1_4a3b2_0000{seed}_{seed}_lr=0.001_2024-01-01_10-00-00"
        run.mkdir()
        (run / "params.json").write_text(json.dumps({"env": "CartPole-v1", "seed": seed}))
        pd.DataFrame(
            {"num_env_steps_sampled_lifetime": [4000, 8000],
             "env_runners/episode_return_mean": [20.0, 40.0 + seed], "node_ip": ["a", "b"]}
        ).to_csv(run / "progress.csv", index=False)  # fmt: skip
    runs, _ = read_runs("rllib", [tmp_path])
    assert [(r.environment, r.seed) for r in runs] == [("CartPole-v1", 0), ("CartPole-v1", 7)]
    assert runs[0].configuration == runs[1].configuration
    assert runs[1].curve.score.tolist() == [20, 47]
    assert runs[1].step == "num_env_steps_sampled_lifetime"


LONG = """algo,lr,seed,t,ep_rew
ppo,0.1,0,10,1
ppo,0.1,0,20,2
ppo,0.1,1,10,3
dqn,0.1,0,10,4
dqn,0.2,0,10,nan
dqn,0.2,0,20,5
"""


def test_a_long_csv(tmp_path):
    (tmp_path / "all.csv").write_text(LONG)
    columns = {"step": "t", "configuration": "algo,lr"}
    runs, _ = read_runs("csv", [tmp_path / "all.csv"], columns=columns)
    names = ["algo=ppo, lr=0.1", "algo=ppo, lr=0.1", "algo=dqn, lr=0.1", "algo=dqn, lr=0.2"]
    assert [(r.configuration, r.seed) for r in runs] == list(zip(names, (0, 1, 0, 0), strict=True))
    assert [r.curve.score.tolist() for r in runs] == [[1, 2], [3], [4], [5]]
    with pytest.raises(ResultsError, match="which column is the step"):
        read_runs("csv", [tmp_path])
    with pytest.raises(ResultsError, match="no column 'missing'; it has algo, lr, seed, t, ep_rew"):
        read_runs("csv", [tmp_path], columns=columns | {"score": "missing"})


ODD = (
    "\ufeffAlgorithm;Random-Seed;Total Timesteps;Episode Reward Mean\nppo;1;10;1,5\nppo;1;20;2,5\n"
)


def test_csv_files_of_other_habits(tmp_path):
    """Semicolons, decimal commas, a byte order mark, titles with spaces; tabs."""
    (tmp_path / "odd.csv").write_text(ODD, encoding="utf-8")
    (run,), _ = read_runs("csv", [tmp_path / "odd.csv"])
    assert (run.configuration, run.seed, run.curve.score.tolist()) == ("ppo", 1, [1.5, 2.5])
    (tmp_path / "odd.csv").write_text("steps\trollout/ep_rew_mean\n1\t-2.5\n", encoding="utf-8")
    (run,), _ = read_runs("csv", [tmp_path / "odd.csv"])
    assert run.curve.score.tolist() == [-2.5]


def test_without_a_column_the_path_says_which_configuration_and_seed_it_is(tmp_path):
    for place in ("ppo/seed1", "ppo/seed2", "dqn/seed1"):
        (tmp_path / place).mkdir(parents=True)
        (tmp_path / place / "log.csv").write_text("step,reward\n1,2\n")
    runs, _ = read_runs("csv", [tmp_path])
    assert [(r.configuration, r.seed) for r in runs] == [("dqn", 1), ("ppo", 1), ("ppo", 2)]


def test_a_grouped_wandb_panel_has_means_of_runs(tmp_path):
    name = "algo: ppo - episodic_return"
    (tmp_path / "panel.csv").write_text(
        f'"Step","{name}","{name}__MIN","{name}__MAX"\n10,1.5,1.0,2.0\n20,2.5,2.0,3.0\n'
    )
    (run,), _ = read_runs("wandb", [tmp_path])
    assert run.configuration == "algo: ppo"
    assert "several values or runs" in run.notes[0]


@pytest.mark.parametrize("kind", READERS)
def test_no_runs(kind, tmp_path):
    with pytest.raises(ResultsError, match=f"no runs in .*: --from {kind} reads"):
        read_runs(kind, [tmp_path])
    with pytest.raises(ResultsError, match="no such file"):
        read_runs(kind, [tmp_path / "none"])


def test_a_run_that_ended_before_it_logged_a_score_is_left_out(tmp_path):
    for seed, names in enumerate((["train/reward", "loss"], ["train/reward", "loss"], ["loss"])):
        for name in names:
            file = tmp_path / f"ppo_seed{seed}" / "scalars" / f"{name}.csv"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text("1,2\n2,3\n")
    runs, others = read_runs("torchrl", [tmp_path])
    assert [run.used for run in runs] == [True, True, False]
    assert runs[2].notes == ("did not log train/reward, left out",)
    assert others == ["loss"]


def test_the_same_quantity_of_all_runs(tmp_path):
    for name, quantity in (("a", "x"), ("b", "y")):
        (tmp_path / name / "scalars").mkdir(parents=True)
        (tmp_path / name / "scalars" / f"{quantity}.csv").write_text("1,2\n")
    with pytest.raises(ResultsError, match="which quantity is the score"):
        read_runs("torchrl", [tmp_path])
    with pytest.raises(ResultsError, match="b did not log 'x'"):
        read_runs("torchrl", [tmp_path], columns={"score": "x"})
    with pytest.raises(ResultsError, match="no run logged 'z'"):
        read_runs("torchrl", [tmp_path], columns={"score": "z"})
