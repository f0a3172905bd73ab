"""``trl-explore COMMAND ...``: import only the module of the command and run it.

``python scripts/train.py ...`` is ``trl-explore train ...`` from a checkout.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from io import TextIOWrapper
from pathlib import Path

from trl_explore.jobs import signals

COMMANDS = {
    "train": "train agents: one job, or a sweep of jobs (-m)",
    "settle": "add trials to a sweep until its comparisons are decided",
    "tune": "tune each strategy, and compare the best settings on other seeds",
    "report": "turn job and sweep folders into one HTML page",
    "watch": "film agents of finished jobs, side by side",
    "map": "train the mixtures of argmax, softmax and uniform, and write a page of them",
    "status": "show which jobs are done, running, failed or left",
    "time": "time single trials of finished jobs",
    "verify": "run finished jobs again and compare the results",
    "thesis": "run the thesis's experiments, time single trials, and write the report",
}
TRACEBACK = "TRL_EXPLORE_TRACEBACK"
"""Environment variable, inherited by workers; empty unless the user asked for full tracebacks."""
LABORATORY = {
    "gymnasium", "hydra", "jinja2", "matplotlib", "numba", "omegaconf", "pandas", "rich",
    "safetensors", "scipy", "yaml",
}  # fmt: skip
"""Modules that the commands need in addition to the core; the extra ``lab`` installs them."""


def main(words: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        words: the name of the command and its arguments; by default those of the process.

    Returns:
        The exit status: 0, or 1 after one line on stderr that describes the error, or 130 after
        Ctrl-C.
    """
    open_streams()
    name, *arguments = (sys.argv[1:] if words is None else words) or ["--help"]
    if name in ("-h", "--help"):
        print("usage: trl-explore COMMAND ...\n")
        print("\n".join(f"  {command:8}{text}" for command, text in COMMANDS.items()))
        print("\ntrl-explore COMMAND --help shows the arguments of a command")
        return 0
    if name not in COMMANDS:
        print(f"error: unknown command {name!r}; available: {', '.join(COMMANDS)}", file=sys.stderr)
        return 1
    try:
        name, arguments = _asked(name, arguments)
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    if name in ("train", "settle", "tune", "thesis"):
        signals.leave_on_signals()
    sys.argv = [f"trl-explore {name}", *arguments]
    logging.basicConfig(format="%(message)s", stream=sys.stderr)
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it works without a home folder
    try:
        status = import_module(f"trl_explore.commands.{name}").main()
        sys.stdout.flush()
        return status
    except BrokenPipeError:  # the reader, such as "| head", has closed the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + 13
    except KeyboardInterrupt as error:
        print(str(error) or "interrupted", file=sys.stderr)
        return getattr(error, "status", 130)
    except (OSError, ModuleNotFoundError) as error:
        if os.environ.get(TRACEBACK) or not (text := _explained(error)):
            raise
        print(f"error: {text}", file=sys.stderr)
        return 1


def _explained(error: OSError | ModuleNotFoundError) -> str:
    """An error of the system, not of the program, in one line; otherwise nothing."""
    if isinstance(error, OSError):  # a file or folder that no command expects to be unreadable
        place = f"{error.filename}: " if error.filename else ""
        return f"{place}{error.strerror or error}"
    if error.name in LABORATORY:
        return f"{error.name} is not installed: pip install 'trl_explore[lab]'"
    return ""


def _asked(name: str, words: Sequence[str]) -> tuple[str, list[str]]:
    """The command that a key of ``train`` asks for: ``until=settled``, ``experiment=tuned``."""
    keys = {w.partition("=")[0]: w.partition("=")[2] for w in words if w[:1] != "-" and "=" in w}
    if name != "train" or not ("until" in keys or keys.get("experiment") == "tuned"):
        return name, list(words)
    if keys.get("until", "settled") != "settled":
        raise ValueError(f"until={keys['until']}: settled is possible")
    if "until" in keys and keys.get("experiment") == "tuned":
        raise ValueError("experiment=tuned: not possible with until=settled")
    if "until" in keys:
        name, flags = "settle", {"trials": "--first", "budget": "--most"}
    else:
        name, flags = "tune", {"trials": "--trials"}
    rest = [w for w in words if w.partition("=")[0] not in (*flags, "until")]
    rest = [w for w in rest if w not in ("experiment=tuned", "-m", "--multirun")]
    given = [word for key, flag in flags.items() if key in keys for word in (flag, keys[key])]
    return name, [*given, *rest]


def open_streams() -> None:
    """Let any text be printed: to a closed stream, and where the terminal has only ASCII."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115
        elif isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
