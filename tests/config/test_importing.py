"""A job imports no compiler of torch; the compiler works in a process that has trained."""

import subprocess
import sys

PROGRAM = """
import sys
import trl_explore
trainer = trl_explore.train("trials=2", "max_iterations=2")
assert trainer.trials.iterations.tolist() == [2, 2]
assert "torch._dynamo" not in sys.modules
import torch
assert "_dynamo" not in vars(torch)
double = torch.compile(lambda x: 2 * x, backend="eager")
assert double(torch.ones(2)).tolist() == [2, 2]
assert len(torch._dynamo.utils.counters["frames"]), "nothing was compiled"
"""


def test_training_imports_no_compiler():
    ended = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
