"""The trials of many jobs in one table."""

import json

import pytest

from tests.jobs.written import CONFIG, write
from trl_explore import jobs as results
from trl_explore import read_frame
from trl_explore.jobs import columns
from trl_explore.jobs.files import ResultsError

FIRST = ["experiment", "job", "folder", "strategy"]


@pytest.fixture
def sweep(tmp_path):
    write(tmp_path / "sweep" / "epsilon_greedy,epsilon=0.1")
    strategy = {"temperature": 2.0}
    write(
        tmp_path / "sweep" / "softmax", strategy="softmax", config={**CONFIG, "strategy": strategy}
    )
    (tmp_path / "sweep" / "unfinished").mkdir()
    return tmp_path / "sweep"


def test_a_sweep_in_one_frame(sweep):
    names = ["epsilon_greedy,epsilon=0.1", "softmax"]
    assert [path.name for path in results.find_jobs(sweep)] == names
    jobs = results.read_jobs([sweep / "softmax", sweep.parent])  # found twice, read once
    assert [job.name for job in jobs] == ["softmax", "epsilon_greedy,epsilon=0.1"]
    frame = read_frame([sweep, sweep.parent])
    assert list(frame)[:4] == FIRST
    trial_columns = [*results.TRIAL_COLUMNS, *columns.PASS_COLUMNS]
    assert list(frame)[-len(trial_columns) :] == trial_columns
    assert frame["strategy"].tolist() == ["epsilon_greedy"] * 3 + ["softmax"] * 3
    assert frame["strategy.epsilon"].tolist()[:3] == [0.1] * 3
    assert frame["strategy.epsilon"].isna().tolist() == [False] * 3 + [True] * 3
    assert frame["strategy.temperature"].tolist()[3:] == [2.0] * 3
    assert frame["trial"].tolist() == [10, 11, 12] * 2
    assert frame["iterations"].dtype == int


def test_one_folder_may_be_a_text_or_a_path(sweep):
    assert len(read_frame(str(sweep))) == len(read_frame(sweep)) == len(read_frame([sweep])) == 6


def test_a_job_counts_once_however_it_is_reached(sweep, tmp_path, monkeypatch):
    (tmp_path / "link").symlink_to(sweep)
    monkeypatch.chdir(tmp_path)
    places = [sweep, sweep / "softmax", "sweep", "./sweep/../sweep", tmp_path / "link"]
    assert len(read_frame(places)) == 6
    assert len(results.read_jobs([tmp_path / "link", sweep])) == 2


def test_a_folder_that_is_missing_is_told(sweep):
    for folders in ("nowhere", ["nowhere"], [sweep, sweep / "nowhere"]):
        with pytest.raises(ResultsError, match="nowhere: no such folder"):
            read_frame(folders)


def test_an_empty_frame_has_its_columns(tmp_path):
    frame = read_frame(tmp_path)
    assert len(frame) == 0
    assert list(frame) == [*FIRST, *results.TRIAL_COLUMNS]


def test_each_trial_has_its_own_value(sweep):
    config = {
        **CONFIG,
        "strategy": {"epsilon": [0.1, 0.2, 0.3], "weights": [1.0, 2.0]},
        "optimizer": {"_target_": "torch.optim.Adam", "lr": [0.5, 0.25, 0.125], "amsgrad": False},
    }
    write(sweep / "swept", config=config)
    frame = read_frame(sweep / "swept")
    assert frame["strategy.epsilon"].tolist() == [0.1, 0.2, 0.3]
    assert frame["optimizer.lr"].tolist() == [0.5, 0.25, 0.125]
    assert [json.loads(x) for x in frame["strategy.weights"]] == [[1.0, 2.0]] * 3
    both = read_frame(sweep)
    assert both.loc[both["job"] == "swept", "strategy.epsilon"].tolist() == [0.1, 0.2, 0.3]


def test_every_value_of_the_configuration_is_a_column(sweep):
    config = {
        **CONFIG,
        "strategy": {"temperature": {"_target_": "a.schedules.Linear", "initial": 5.0}},
        "optimizer": {"_target_": "x.optimizers.TrialAdam", "lr": 0.01},
        "correction": {"_target_": "x.PerStep"},
        "baseline": {"_target_": "x.ConstantBaseline", "value": 0.0},
        "policy": {"_target_": "x.LinearPolicy"},
    }
    frame = read_frame(write(sweep / "all", config=config))
    first = frame.iloc[0].to_dict()
    wanted = {
        "strategy": "epsilon_greedy", "strategy.temperature": "Linear",
        "strategy.temperature.initial": 5.0, "optimizer": "TrialAdam", "optimizer.lr": 0.01,
        "correction": "PerStep", "baseline": "ConstantBaseline", "baseline.value": 0.0,
        "policy": "LinearPolicy", "env.id": "CartPole-v1", "max_iterations": 4,
    }  # fmt: skip
    assert {key: first[key] for key in wanted} == wanted
    assert len(set(frame)) == len(list(frame))
