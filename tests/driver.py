"""Run the commands of a script as a shell would, many of them in one process.

    python tests/driver.py [--cold]

Every line of standard input asks for a batch: a script, a folder, and the arguments of each
command; a text among the commands is Python to execute. Every line of standard output answers with
[status, standard output, standard error, whether torch is imported] of each command.

Importing torch and loading compiled code costs seconds. So the driver does that once, by a small
job, and forks a process for each batch: what a batch changes in its process ends with it. With
``--cold`` nothing is imported before the first command.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import runpy
import sys
import tempfile
import traceback
from pathlib import Path
from typing import Any

SCRIPTS = Path(__file__).resolve().parents[1] / "scripts"
SMALL = ["experiment=debug", "trials=1", "max_iterations=1", "threads=1"]


def call(script: str, arguments: list[str]) -> list[Any]:
    """One command."""
    from hydra.core.global_hydra import GlobalHydra

    GlobalHydra.instance().clear()
    os.environ.pop("HYDRA_FULL_ERROR", None)
    sys.argv = [script, *arguments]
    out, err, code = io.StringIO(), io.StringIO(), 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            runpy.run_path(script, run_name="__main__")
        except SystemExit as exit:
            code = exit.code or 0
        except BaseException:
            traceback.print_exc()
            code = 1
    return [code, out.getvalue(), err.getvalue(), "torch" in sys.modules]


def run(script: str, folder: str, commands: list[str | list[str]]) -> list[list[Any]]:
    """A batch of commands, from within ``folder``."""
    os.chdir(folder)
    results = []
    for command in commands:
        if isinstance(command, str):
            exec(command, {})
        else:
            results.append(call(script, command))
    return results


def fork(batch: list[Any]) -> str:
    """The answer to a batch, from a process of its own; empty if that ended before."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            with os.fdopen(writing, "w", encoding="utf-8") as pipe:
                pipe.write(json.dumps(run(*batch)))
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading, encoding="utf-8") as pipe:
        answer = pipe.read()
    os.waitpid(child, 0)
    return answer


def main() -> None:
    """Answer until standard input ends."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what a batch prints past ``sys.stdout`` is no answer
    sys.path[0] = ""  # as for ``python -c``: commands find modules in their folder
    cold = "--cold" in sys.argv
    if not cold:
        with tempfile.TemporaryDirectory() as folder:
            status, _, error, _ = call(str(SCRIPTS / "train.py"), [*SMALL, f"output_dir={folder}"])
            assert status == 0, error
    for line in sys.stdin:
        batch = json.loads(line)
        print(json.dumps(run(*batch)) if cold else fork(batch), file=answers, flush=True)


if __name__ == "__main__":
    main()
