"""Jobs composed in a program: those of the command line."""

from __future__ import annotations

import numpy as np
import pytest

from trl_explore import read_frame, train
from trl_explore.config import ConfigError


def test_the_trials_are_those_of_the_command_line(run_many, tmp_path):
    words = ["experiment=debug", "strategy=epsilon_greedy", "strategy.epsilon=0.1"]
    (done,) = run_many([[*words, f"output_dir={tmp_path}"]], tmp_path)
    assert done.returncode == 0, done.stderr
    frame, trainer = read_frame([tmp_path]), train(*words)
    np.testing.assert_array_equal(trainer.trials.score, frame["score"])
    np.testing.assert_array_equal(trainer.evaluator.learned_score, frame["learned_score"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["strategy=softmax,argmax"], "strategy=softmax,argmax gives several values"),
        (["experiment=thesis"], "this is a sweep: give one job"),
        (["strategy.epsilon=0.1"], "unknown key 'strategy.epsilon'"),
        (["optimizer.lr=0"], "optimizer: lr must be a number > 0, got 0"),
    ],
)
def test_wrong_words_are_one_line(words, message):
    with pytest.raises(ConfigError, match=message) as caught:
        train(*words)
    assert "\n" not in str(caught.value)


def test_a_folder_of_ones_own(tmp_path):
    (tmp_path / "strategy").mkdir()
    (tmp_path / "strategy" / "mine.yaml").write_text(
        "_target_: trl_explore.strategies.Softmax\ntemperature: 3.0\n", encoding="utf-8"
    )
    trainer = train("experiment=debug", "strategy=mine", config_dir=tmp_path)
    assert float(trainer.collector.strategy.temperature) == 3.0
    with pytest.raises(ConfigError, match="nowhere: no such folder"):
        train(config_dir="nowhere")
