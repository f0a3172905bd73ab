import re

import numpy as np

from trl_explore.report.curves import running_means
from trl_explore.report.evidence import gather
from trl_explore.report.groups import group_jobs
from trl_explore.report.loading import load
from trl_explore.report.page import group_facts
from trl_explore.report.writing import build_report


def test_different_caps_stand_in_one_report_but_are_not_compared(tmp_path, make_job):
    for cap in (500, 1000):
        for strategy in ("softmax", "argmax"):
            make_job(tmp_path / "train", f"{strategy},{cap}", [150, 200, cap], strategy=strategy,
                     cap=cap)  # fmt: skip
    groups = gather(load([tmp_path])).groups
    assert [g.group.cap for g in groups] == [1000, 500]
    assert all(len(g.comparisons) == 1 for g in groups)
    assert len({g.group.id for g in groups}) == 2
    page, _ = build_report([tmp_path], tmp_path / "out")
    assert 'href="map.html"' not in page.read_text(encoding="utf-8")


def test_a_map_beside_the_report_is_linked(tmp_path, make_job):
    make_job(tmp_path / "train", "softmax", [150, 200])
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "map.html").touch()
    page, _ = build_report([tmp_path], tmp_path / "out")
    assert page.read_text(encoding="utf-8").count('<a href="map.html">') == 1


def test_different_environments_are_not_compared(tmp_path, make_job):
    make_job(tmp_path / "train", "a", [150, 200], env="CartPole-v1")
    make_job(tmp_path / "train", "b", [150, 200], env="Acrobot-v1", strategy="argmax")
    assert len(group_jobs(load([tmp_path]).jobs)) == 2


def test_trials_stopped_by_evaluation_stand_beside_those_stopped_by_training(tmp_path, make_job):
    """They are the same agents, of which one job must not push the other out of the report."""
    make_job(tmp_path / "train", "softmax", [150, 200])
    make_job(tmp_path / "train", "softmax,stop_on=evaluation", [105, 110], evaluate_every=5,
             stop_on="evaluation")  # fmt: skip
    groups = group_jobs(load([tmp_path]).jobs)
    means = {c.judged_by: c.iterations.mean() for g in groups for c in g.configurations}
    assert means == {"training": 175, "evaluation (1 every 5 iterations)": 107.5}
    texts = sorted(group_facts(group) for group in groups)
    assert texts[0].endswith("over 100 episodes of evaluation (1 every 5 iterations); cap 1,000"
                             " iterations.")  # fmt: skip
    assert texts[1].endswith("over 100 episodes; cap 1,000 iterations.")


def test_seeds_of_a_configuration_are_pooled(tmp_path, make_job):
    for seed in (0, 1):
        make_job(tmp_path / "train", f"softmax,seed={seed}", [150, 200], seed=seed)
    (group,) = group_jobs(load([tmp_path]).jobs)
    assert [len(c) for c in group.configurations] == [4]


def test_trials_that_two_folders_share_count_once(tmp_path, make_job):
    for copy in ("one", "two"):
        make_job(tmp_path / copy / "train", "softmax", [150, 200])
    (group,) = group_jobs(load([tmp_path]).jobs)
    assert [len(c) for c in group.configurations] == [2]


def test_configurations_of_one_name_are_both_kept(tmp_path, make_job):
    for temperature in (1.0, 2.0):
        make_job(tmp_path / str(temperature) / "train", "softmax", [150, 200],
                 parameters={"temperature": temperature})  # fmt: skip
    (group,) = group_jobs(load([tmp_path]).jobs)
    assert list(group.labels.values()) == ["T = 1", "T = 2"]
    assert len(gather(load([tmp_path])).groups[0].comparisons) == 1


def test_one_strategy_alone_one_trial_alone_and_nothing_converged(tmp_path, make_job):
    for name, durations in {"alone": [150, 170], "single": [150], "never": [1000, 1000]}.items():
        make_job(tmp_path / name, "softmax", durations)
        page, gaps = build_report([tmp_path / name], tmp_path / "out" / name)
        html = page.read_text()
        assert not gaps
        assert "Only softmax was run" in html
        assert "thesis" not in re.sub("<style.*?</style>|<code>.*?</code>", "", html, flags=re.S)
        assert "No comparison: there is only one configuration." in html


def test_a_diverged_trial_is_counted_and_named(tmp_path, make_job):
    make_job(tmp_path / "train", "softmax", [150, 40, 200], diverged=(1,))
    page, _ = build_report([tmp_path], tmp_path / "out")
    assert "2 of 3, 1 diverged" in page.read_text()


def test_running_scores_by_hand():
    trial, iteration = np.array([0, 0, 0, 1]), np.array([1, 2, 3, 1])
    scores = np.array([10.0, 20.0, 40.0, 7.0])
    table = running_means(trial, iteration, scores, 2, np.array([1, 2, 3, 5]))
    # Trial 0: means of the last two; trial 1 stopped after one episode and keeps its score.
    assert table.T.tolist() == [[10.0, 15.0, 30.0, 30.0], [7.0, 7.0, 7.0, 7.0]]


def test_sections_of_other_environments_or_caps_are_told_apart_by_their_titles(tmp_path, make_job):
    make_job(tmp_path / "train", "a", [150, 200], env="CartPole-v1")
    make_job(tmp_path / "train", "b", [150, 200], env="Acrobot-v1")
    make_job(tmp_path / "train", "c", [150, 200], env="Acrobot-v1", cap=500)
    titles = {g.title for g in group_jobs(load([tmp_path]).jobs)}
    assert titles == {
        "softmax, CartPole-v1", "softmax, Acrobot-v1, cap 1,000", "softmax, Acrobot-v1, cap 500"
    }  # fmt: skip
    page, _ = build_report([tmp_path], tmp_path / "out")
    text = page.read_text(encoding="utf-8")
    assert "learned Acrobot-v1 with REINFORCE (separate sections cover CartPole-v1)." in text


def test_a_cap_before_the_first_full_window_is_told(tmp_path, make_job):
    make_job(tmp_path / "train", "a", [50, 50], cap=50)
    make_job(tmp_path / "train", "b", [50, 50], cap=50, strategy="random")
    page, _ = build_report([tmp_path], tmp_path / "out")
    text = page.read_text(encoding="utf-8")
    assert re.search("No trial could pass: the cap of 50 iterations .* 100 episodes", text)
