"""What ``scripts/train.py`` refuses, in one line, and what it says of itself."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest

from tests.commands.trained import (
    SCRIPT,
    STRATEGIES,
    TINY,
    complaints,
    results_below,
)
from trl_explore.jobs.reading import read_jobs

WRONG = {
    f"seed={2**63}": "seed ... <= 9223372036854775807",
    f"first_trial={2**63 - 1} trials=2": "first_trial ... <=",
    "trials=100000000000": "trials ... <=",
    "env.max_steps=1000000000000": "max_steps ... <=",
    "episodes=maybe": "episodes ... true ... false ... 'maybe'",
    "restart=perhaps": "restart ... true ... false ... 'perhaps'",
    "~loss.gamma": "loss.gamma",
    "strategy=null": "strategy",
    "collector=fused env=taxi +env.kwargs.fickle_passenger=true": "fickle_passenger",
    "strategy=thompson": "strategy=thompson",
    "strategy=epsilon_greedy strategy.epsilon=1.5": "in [0, 1] ... 1.5",
    "strategy=epsilon_greedy strategy.epsilon=-0.1": "in [0, 1] ... -0.1",
    "strategy=epsilon_greedy strategy.epsilon=nan": "in [0, 1] ... nan",
    "strategy=epsilon_greedy strategy.epsilon=[0.1,0.2]": "2 values ... 3 trials",
    "strategy=decaying_epsilon_greedy strategy.decay=1.01": "in [0, 1] ... 1.01",
    "strategy.temperature=0": "temperature ... > 0 ... 0",
    "strategy.temperature=-2": "temperature ... > 0 ... -2",
    "strategy.temperature=nan": "temperature ... > 0 ... nan",
    "strategy.temperature=[1": "[1",
    "trials=0": "trials ... >= 1 ... 0",
    "trials=x": "trials ... >= 1 ... 'x'",
    "first_trial=-1": "first_trial ... >= 0 ... -1",
    "seed=-1": "seed ... >= 0 ... -1",
    "max_iterations=0": "max_iterations ... >= 1 ... 0",
    "score_window=0": "score_window ... >= 1 ... 0",
    "score_threshold=nan": "score_threshold ... finite ... nan",
    "optimizer.lr=-0.05": "lr ... > 0 ... -0.05",
    "optimizer.lr=nan": "lr ... > 0 ... nan",
    "optimizer=lion": "optimizer=lion",
    "loss.gamma=1.5": "gamma ... in [0, 1] ... 1.5",
    "loss.gamma=nan": "gamma ... in [0, 1] ... nan",
    "loss.reduction=mean": "mean",
    "env=pong": "env=pong",
    "env=gym": "env.id",
    "env=gym env.id=NoSuch-v7": "NoSuch-v7",
    "env=gym env.id=Taxi-v3": "Taxi-v3",
    "env=gym env.id=Pendulum-v1": "continuous actions ... Softmax and LinearPolicy",
    "env=gym env.id=Blackjack-v1": "Blackjack-v1",
    "env=gym env.id=CliffWalking-v1": "max_steps",
    "env.max_steps=0": "max_steps ... >= 1 ... 0",
    "env.max_steps=nan": "max_steps ... >= 1 ... nan",
    "foo=1": "'foo'",
    "lr=0.1": "unknown key 'lr'; did you mean optimizer.lr?",
    "stategy=softmax": "unknown key 'stategy'; did you mean strategy?",
    "+lr=0.1": "unknown key 'lr'; did you mean optimizer.lr?",
    "strategy=epsilon_greedy epsilon=0.1": "'epsilon'; did you mean strategy.epsilon?",
    "strategy=epsilon_greedy strategy.epsilom=1": "'strategy.epsilom'; did you mean strategy.ep",
    "env=torchrl": "env.target must be set, e.g. env.target=…",
    "env=gym env.id=": "env.id must be the name of an environment, e.g. ... got ''",
    "seed=1,2": "seed=1,2 gives several values: add -m ... 'seed=[1,2]'",
    "-cn nope": "there is no configuration 'nope'; without --config-name it is 'train'",
    "=3": "'=3'; arguments have the form key=value",
    "'seed=3": "arguments have the form key=value",
    "+foo=1": "'foo'",
    "++foo=1": "'foo'",
    "strategy.foo=1": "'strategy.foo'",
    "env.kwargs={render_mode:rgb}": "+env.kwargs={render_mode:rgb}",
    "env.attributes.gravity=3.7": "+env.attributes.gravity=3.7",
    "+strategy.foo=1": "'strategy.foo'",
    "+loss.lr=1": "'loss.lr'",
    "+env.kwargs.foo=1": "foo",
    "~optimizer.lr": "lr",
    "~trials": "trials",
    "collector=warp": "collector=warp",
    "experiment=nope": "experiment=nope",
    "-m strategy=softmax,thompson trials=0": "",
    "output_dir={file}/x": "{file}/x",
    "output_dir=/proc/no/where": "/proc/no",
    "nonsense": "nonsense",
}


@pytest.fixture(scope="module")
def refused(tmp_path_factory, run_many):
    """Every wrong command, each with an output folder of its own."""
    place = tmp_path_factory.mktemp("wrong")
    (place / "file").write_text("a file")
    commands = []
    for k, text in enumerate(WRONG):
        arguments = text.replace("{file}", str(place / "file")).split()
        experiment = [] if "experiment=" in text else ["experiment=debug"]
        output = [] if "output_dir=" in text else [f"output_dir={place / str(k)}"]
        commands.append([*experiment, *output, *arguments])
    return place, dict(zip(WRONG, run_many(commands, cwd=place), strict=True))


@pytest.mark.parametrize("text", WRONG)
def test_wrong_input_is_one_line(refused, text):
    place, ran = refused
    process = ran[text]
    assert process.returncode not in (0, None)
    assert "Traceback" not in process.stderr + process.stdout
    if text.startswith("-m "):
        return
    (line,) = complaints(process)
    assert line.startswith("error: ")
    parts = WRONG[text].replace("{file}", str(place / "file")).split(" ... ")
    assert re.search(".*".join(map(re.escape, parts)), line)
    assert process.stdout == ""


def test_wrong_input_leaves_no_results(refused):
    place, _ = refused
    assert results_below(place) == []
    assert (place / "file").read_text() == "a file"


def test_wrong_input_leaves_no_folder_of_jobs(refused):
    place, ran = refused
    left = {text: list((place / str(k)).glob("*")) for k, text in enumerate(ran) if text[0] != "-"}
    assert {text: folders for text, folders in left.items() if folders} == {}


def test_a_sweep_may_be_asked_for_anywhere(run_many, tmp_path):
    debug = ["experiment=debug", "max_iterations=1", f"output_dir={tmp_path}"]
    (process,) = run_many([[*debug, "-m", "strategy=random,argmax"]], cwd=tmp_path)
    assert (process.returncode, complaints(process)) == (0, [])
    assert "random" in process.stdout
    assert "argmax" in process.stdout


def test_wrong_input_in_a_process_of_its_own(run_cli, tmp_path):
    process = run_cli("strategy=epsilon_greedy", "strategy.epsilon=2", cwd=tmp_path)
    assert process.returncode == 1
    assert process.stdout == ""
    assert re.fullmatch(r"error: strategy: epsilon.*\[0, 1\].*2\n", process.stderr)
    assert not results_below(tmp_path)


def test_a_sweep_over_schedules(run_many, tmp_path):
    debug = ["experiment=debug", f"output_dir={tmp_path}", "strategy=softmax"]
    kinds = "+schedule@strategy.temperature=linear,cosine"
    (ran,) = run_many([["-m", *debug, kinds, "++strategy.temperature.initial=5"]], tmp_path)
    assert (ran.returncode, complaints(ran)) == (0, [])
    rest = "temperature.final=0.1,temperature.initial=5.0,temperature.iterations=500"
    expected = {f"softmax,temperature={kind},{rest}" for kind in ("linear", "cosine")}
    assert {path.name for path in (tmp_path / "debug").iterdir() if path.is_dir()} == expected
    assert len(read_jobs([tmp_path])) == 2


def test_one_wrong_job_does_not_stop_a_sweep(run_many, tmp_path):
    (ran,) = run_many(
        [
            [
                "-m", "experiment=debug", "strategy=epsilon_greedy",
                "strategy.epsilon=0.1,2,0.4", f"output_dir={tmp_path}",
            ]
        ],
        cwd=tmp_path,
    )  # fmt: skip
    assert ran.returncode == 1
    first, summary, last = complaints(ran)
    reason = first.removeprefix("error: ")
    assert re.match(r"epsilon_greedy,epsilon=2\.0: .*epsilon.*\[0, 1\].*2", reason)
    assert "1 of 3" in summary
    assert last.strip() == reason
    finished = {path.parent.name for path in results_below(tmp_path) if path.name == "run.json"}
    assert finished == {"epsilon_greedy,epsilon=0.1", "epsilon_greedy,epsilon=0.4"}
    assert len(ran.stdout.splitlines()) == 5  # header, rule, two jobs, place


def test_folders_of_a_sweep_may_have_other_names(run_many, tmp_path):
    """The number of the job, which the plan must know; and one folder for two jobs is refused."""
    words = ["-m", "experiment=debug", "max_iterations=1", "strategy=epsilon_greedy"]
    numbered, single = run_many(
        [
            [*words, "strategy.epsilon=0.1,2", "hydra.sweep.subdir=${hydra.job.num}",
             f"output_dir={tmp_path / 'numbered'}"],
            [*words, "strategy.epsilon=0.1,0.2", "hydra.sweep.subdir=one",
             f"output_dir={tmp_path / 'single'}"],
        ],
        cwd=tmp_path,
    )  # fmt: skip
    assert (numbered.returncode, single.returncode) == (1, 1)
    assert re.match(r"error: 1: .*epsilon.*\[0, 1\].*2", complaints(numbered)[0])
    assert numbered.stdout.splitlines()[-1] == f"results: {tmp_path / 'numbered' / 'debug' / '0'}"
    assert "another configuration" in complaints(single)[0]


# Help


def test_help_and_configuration_without_torch(run_many, tmp_path):
    helped, shown, sweep = run_many(
        [
            ["--help"],
            ["--cfg", "job", "--resolve", "strategy=epsilon_greedy", "optimizer.lr=0.25"],
            ["--cfg", "job", "--resolve", "experiment=epsilon_grid"],
        ],
        cwd=tmp_path,
        cold=True,
    )
    for process in (helped, shown, sweep):
        assert (process.returncode, complaints(process)) == (0, [])
        assert not process.torch
    for text in (
        "trl-explore train -m",
        "strategy: argmax, ",
        "experiment: baselines, ",
        "trials: 30",
        "# Trial k of a seed is the same agent in every job.\nseed: 0   # of all random numbers",
        "  discount_steps: false   # multiply by gamma^t\n",
        "10 % more each time, and the cap, where there is a compiled kernel; n: every n",
        "max_iterations: ${env.max_iterations}   # the cap",
    ):
        assert text in helped.stdout
    assert "epsilon: 0.3" in shown.stdout
    assert "weight: 0.25" in shown.stdout
    assert "trials: 20" in sweep.stdout
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_flag_is_one_line(run_cli, tmp_path):
    process = run_cli("--foo", "trials=2", cwd=tmp_path)
    assert (process.returncode, process.stdout) == (1, "")
    assert complaints(process) == [
        "error: unrecognized arguments: --foo; --hydra-help lists the flags"
    ]


def test_a_reader_that_has_left_is_no_error():
    """As ``trl-explore train --help | true``: the pipe is closed before the first byte."""
    reading, writing = os.pipe()
    os.close(reading)
    process = subprocess.run(
        [sys.executable, str(SCRIPT), "--help"], stdout=writing, stderr=subprocess.PIPE, text=True
    )
    os.close(writing)
    assert (process.returncode, process.stderr) == (141, "")


def test_tab_completion_without_torch(run_cli, tmp_path):
    line = "python scripts/train.py strategy="
    (tmp_path / "torch").mkdir()
    (tmp_path / "torch" / "__init__.py").write_text("raise SystemExit('torch was imported')")
    process = run_cli(
        "-sc",
        "query=bash",
        cwd=tmp_path,
        environment={
            "COMP_LINE": line,
            "COMP_POINT": str(len(line)),
            "COMP_CWORD": "2",
            "PYTHONPATH": f"{tmp_path}:{SCRIPT.parent.parent}",
        },
    )
    assert process.returncode == 0, process.stderr
    assert set(process.stdout.split()) >= {f"strategy={strategy}" for strategy in STRATEGIES}
    assert "torch was imported" not in process.stderr


@pytest.mark.parametrize("value", ["ü", "a=b", "~/x", "результаты"])
def test_what_the_grammar_cannot_read_is_shown_with_its_quotes(run_many, tmp_path, value):
    word = f"output_dir={value}"
    refused, accepted = run_many(
        [[word, *TINY], [f"output_dir='{tmp_path}/{value.replace('~', '')}'", *TINY]], tmp_path
    )
    assert refused.returncode == 1
    (line,) = refused.stderr.splitlines()
    assert word in line
    assert f"output_dir='{value}'" in line
    assert accepted.returncode == 0, accepted.stderr


def test_a_tilde_is_the_home_of_the_user(run_many, tmp_path):
    home = f"import os; os.environ['HOME'] = {str(tmp_path / 'home')!r}"
    ran, nobody = run_many(
        [home, ["output_dir='~/results'", *TINY], ["output_dir='~no_such_user/x'", *TINY]], tmp_path
    )
    assert ran.returncode == 0, ran.stderr
    assert complaints(nobody) == [
        "error: output_dir=~no_such_user/x: the user of this ~ has no home folder"
    ]
    assert [path.name for path in tmp_path.iterdir()] == ["home"]


def test_equal_numbers_are_one_job(run_many, tmp_path):
    words = ["-m", "env=gym", "env.id=CartPole-v1", "score_threshold=100,100.0", *TINY]
    (ran,) = run_many([words], tmp_path)
    assert ran.returncode == 0, ran.stderr
    assert len([p for p in (tmp_path / "outputs" / "train").iterdir() if p.is_dir()]) == 1


def test_the_users_code_is_part_of_a_job(run_many, tmp_path):
    """A job with changed code is neither resumed nor called finished."""
    source = """
import gymnasium as gym, numpy as np
REWARD = 1.0
class Env(gym.Env):
    observation_space = gym.spaces.Box(-1, 1, (3,), np.float32)
    action_space = gym.spaces.Discrete(2)
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(3, np.float32), {}
    def step(self, action):
        return np.zeros(3, np.float32), REWARD, False, False, {}
gym.register("Own-v0", entry_point=Env, max_episode_steps=5)
"""
    (tmp_path / "own_env.py").write_text(source)
    path = f"import sys; sys.path.insert(0, {str(tmp_path)!r})"
    words = ["env=gym", "env.id=own_env:Own-v0", "score_threshold=1e6", *TINY]
    first, again = run_many([path, words, words], tmp_path)
    assert first.returncode == again.returncode == 0, first.stderr
    (tmp_path / "own_env.py").write_text(source.replace("REWARD = 1.0", "REWARD = 100.0"))
    (changed,) = run_many([path, words], tmp_path)
    assert changed.returncode == 1
    (line,) = changed.stderr.splitlines()
    assert "own_env" in line
    assert "restart=true" in line
