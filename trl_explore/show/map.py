"""The map: what the agents of every mixture did and learned, as one page."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from io import BytesIO
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from jinja2 import Environment
from markupsafe import Markup
from tensordict.nn import TensorDictSequential

from trl_explore import policies, strategies
from trl_explore.collectors import auto_collector
from trl_explore.envs import make_env
from trl_explore.jobs.columns import EVALUATIONS
from trl_explore.jobs.files import ResultsError
from trl_explore.jobs.reading import find_jobs, read_job
from trl_explore.jobs.records import read_curves, read_weights
from trl_explore.names import option_of, strategy_label
from trl_explore.show.playing import Episode, episode_of, replayed
from trl_explore.statistics import samples
from trl_explore.statistics.estimates import Estimate, pass_rate
from trl_explore.statistics.evaluations import schedule
from trl_explore.statistics.means import mean_interval
from trl_explore.statistics.outcomes import MEASURES, Outcomes, convergence_times, judged
from trl_explore.statistics.samples import Sample
from trl_explore.statistics.survival import kaplan_meier

CORRECTIONS = ("NoCorrection", "PerStep")
"""The corrections of the map: off and on."""
FRAMES = 300
"""Most frames of a film in the page."""
POINTS = 60
"""Most steps of a survival curve in the page."""


@dataclass(frozen=True)
class Drawing:
    """How the page draws an environment.

    Attributes:
        kind: the name of the drawing in the page.
        state: the whole numbers that it draws, from the environment and its observation.
        about: further values that it needs, from the environment.
    """

    kind: str
    state: Callable[[Any, Any], list[int]]
    about: Callable[[Any], dict[str, Any]] = lambda env: {}


DRAWINGS: Mapping[str, Drawing] = {
    "CartPole-v1": Drawing("cartpole", lambda _, o: [round(1000 * float(x)) for x in (o[0], o[2])]),
    "FrozenLake-v1": Drawing(
        "grid",
        lambda _, o: [int(o)],
        lambda env: {"rows": ["".join(c.decode() for c in row) for row in env.desc]},
    ),
    "trl_explore/Catch-v0": Drawing(
        "catch",
        lambda env, _: [env.row, env.column, env.paddle],
        lambda env: {"rows": env.rows, "columns": env.columns},
    ),
}
"""The environments that the page can draw, by gymnasium id; they come first."""


def point_of(config: Mapping[str, Any]) -> tuple[list[float], float] | None:
    """The weights of argmax, softmax and uniform, and the temperature; None: no such point.

    An ε that decays moves from uniform to argmax, and is placed at argmax, where it ends.
    """
    strategy = config["strategy"]
    kind = str(strategy.get("_target_", "")).rsplit(".", 1)[-1]
    temperature = strategy.get("temperature", 1.0)
    if kind == "FullMixture":
        weights = [strategy[name] for name in ("greedy", "softmax", "uniform")]
    elif kind == "DecayingEpsilonGreedy":
        weights = [1.0, 0.0, 0.0]
    else:
        return None
    if not all(isinstance(value, int | float) for value in (*weights, temperature)):
        return None
    return [weight / sum(weights) for weight in weights], float(temperature)


def read_cells(folder: Path, say: Callable[[str], None] = lambda text: None) -> dict[str, Any]:
    """Everything that the page shows of the jobs at or below a folder.

    Jobs of other strategies and corrections than those of the map are left out.

    Args:
        folder: the folder.
        say: called with a line for every cell.

    Raises:
        ResultsError: if no job is a cell, or one cannot be read.
    """
    tasks: dict[str, dict[str, Any]] = {}
    cells = []
    for job in find_jobs(folder):
        outcomes = read_job(job)
        point, correction = point_of(outcomes.config), option_of(outcomes.config, "correction")
        if point is None or correction not in CORRECTIONS or outcomes.learned is None:
            continue
        say(f"cell {len(cells) + 1}: {job.name}")
        id = str(outcomes.config["env"]["id"])
        episode, states, about = _film(job, outcomes, id)
        task = tasks.setdefault(id, {
            "id": id, "cap": outcomes.cap, "threshold": outcomes.threshold, **about,
        })  # fmt: skip
        if task["cap"] != outcomes.cap or task["threshold"] != outcomes.threshold:
            raise ResultsError(f"{job}: another cap or threshold than the other cells of {id}")
        cells.append({
            "task": list(tasks).index(id), "corrected": CORRECTIONS.index(correction),
            "w": [round(w, 4) for w in point[0]], "T": point[1],
            "decays": outcomes.strategy == "decaying_epsilon_greedy", "n": len(outcomes),
            "name": strategy_label(outcomes.strategy),
            **_numbers(outcomes), "curve": _curve(job, outcomes),
            "film": _shown(episode, states),
        })  # fmt: skip
    if not cells:
        raise ResultsError(f"{folder}: no finished job of strategy=mixture with evaluations")
    return {"tasks": list(tasks.values()), "cells": cells}


def _numbers(outcomes: Outcomes) -> dict[str, Any]:
    """Rates, restricted means and survival curves of what was done and what was learned."""
    found: dict[str, Any] = {"score": _three(mean_interval(samples.scores(outcomes)))}
    for measure in MEASURES:
        event = outcomes.passed if measure == "passed" else outcomes.learned
        assert event is not None
        rate = pass_rate(int(event.sum()), len(outcomes))
        entry: dict[str, Any] = {"rate": _three(rate), "mean": None, "survival": None}
        try:
            own = judged(outcomes, measure)
        except ValueError:  # too many trials were stopped by the other measure
            own = None
        if own is not None:
            entry["mean"] = _three(mean_interval(samples.iterations(own)))
            curve = kaplan_meier(*convergence_times(own))
            at = np.unique(np.linspace(0, len(curve.times) - 1, POINTS).round().astype(int))
            entry["survival"] = [
                [_short(x) for x in column[at]]
                for column in (curve.times, curve.survival, curve.low, curve.high)
            ]
        found[measure] = entry
    assert outcomes.learned_score is not None
    found["learned_score"] = _three(mean_interval(Sample.of(outcomes.learned_score)))
    return found


def _curve(job: Path, outcomes: Outcomes) -> list[list[float | None]]:
    """Iterations; the mean learned score with its interval; the mean score while exploring.

    A trial that has stopped keeps its last value.
    """
    frame: Any = pd.read_csv(BytesIO((job / EVALUATIONS).read_bytes()))
    frame = frame[frame["purpose"] == "scheduled"]
    table = frame.groupby(["iteration", "trial"])["score"].mean().unstack().ffill()
    at = schedule("auto", outcomes.cap)
    assert at is not None
    table = table.reindex(at).ffill()
    learned = [mean_interval(Sample.of(row)) for row in table.to_numpy()]
    behaved = read_curves(job)["episode_score"].reindex(range(1, outcomes.cap + 1)).ffill()
    now = [float(behaved.loc[max(1, i)]) for i in at]
    columns = [at.tolist(), *zip(*(_three(e) for e in learned), strict=True), map(_short, now)]
    return [list(column) for column in columns]


def _film(
    job: Path, outcomes: Outcomes, id: str
) -> tuple[Episode | None, list[list[int]], dict[str, Any]]:
    """The next training episode of the typical agent: that of the median final score."""
    drawing = DRAWINGS.get(id)
    usable = np.flatnonzero(outcomes.status != "diverged")
    if drawing is None or not len(usable):
        return None, [], {"kind": ""}
    score = outcomes.score[usable]
    k = int(usable[np.abs(score - np.sort(score)[len(score) // 2]).argmin()])
    config, at = outcomes.config, int(outcomes.iterations[k])
    streams = {"seed": config["seed"], "first_trial": int(outcomes.trial[k])}
    own = config["env"]
    env = make_env(
        id, 1, own.get("max_steps"), kwargs=own["kwargs"], attributes=own["attributes"], **streams
    )
    plain = {key: value for key, value in config["policy"].items() if key != "lr"}
    policy = _built(policies, plain, env=env, **streams)
    weights = read_weights(job)
    for name, parameter in policy.named_parameters():
        parameter.data.copy_(torch.from_numpy(weights[name][k : k + 1]))
    strategy = _built(strategies, config["strategy"])
    collector = auto_collector(env, TensorDictSequential(policy, strategy), announce=False)
    for _ in range(at if outcomes.strategy == "decaying_epsilon_greedy" else 0):
        strategy.step()
    number = at * config["episodes_per_update"]
    episode = episode_of(collector, number, int(outcomes.trial[k]), at, True)
    states = replayed(episode, lambda env, o: drawing.state(env.unwrapped, o))
    inner: Any = collector.lanes.envs[0].unwrapped
    about = {"kind": drawing.kind, **drawing.about(inner)}
    collector.shutdown()
    return episode, states, about


def _built(room: Any, config: Mapping[str, Any], **more: Any) -> Any:
    """An object of the package that a configuration names; no other is constructed."""
    name = str(config["_target_"]).rsplit(".", 1)[-1]
    if name not in room.__all__:
        raise ResultsError(f"the map has no {name}")
    options = {key: value for key, value in config.items() if not key.startswith("_")}
    return getattr(room, name)(**options, **more)


def _shown(episode: Episode | None, states: list[list[int]]) -> dict[str, Any] | None:
    """An episode as the page draws it: a column per number of the state, and the marks."""
    if episode is None:
        return None
    assert episode.exploratory is not None
    return {
        "trial": episode.trial,
        "states": [list(column) for column in zip(*states[: FRAMES + 1], strict=True)],
        "actions": "".join(map(str, episode.action[:FRAMES].tolist())),
        "exploratory": np.flatnonzero(episode.exploratory[:FRAMES]).tolist(),
        "rewards": [] if np.all(episode.reward == 1) else episode.reward[:FRAMES].tolist(),
        "score": episode.score,
        "steps": len(episode.action),
        "terminated": episode.terminated,
    }


def _three(estimate: Estimate) -> list[float | None]:
    return [_short(x) for x in (estimate.value, estimate.low, estimate.high)]


def _short(value: float) -> float | None:
    """Four digits; None where there is no number."""
    return float(f"{value:.4g}") if isfinite(value) else None


HERE = Path(__file__).parent


def page(found: Mapping[str, Any]) -> str:
    """The page of what ``read_cells`` has found."""
    tasks, cells = found["tasks"], found["cells"]
    first = list(DRAWINGS)
    order = sorted(range(len(tasks)), key=lambda i: ((*first, id := tasks[i]["id"]).index(id), id))
    cells = [{**cell, "task": order.index(cell["task"])} for cell in cells]
    cells.sort(key=lambda cell: (cell["task"], cell["corrected"], cell["T"], cell["w"]))
    counts = sorted({cell["n"] for cell in cells})
    data = {"tasks": [tasks[i] for i in order], "cells": cells}
    text = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    template = Environment(autoescape=True, keep_trailing_newline=True).from_string(
        (HERE / "map.html").read_text(encoding="utf-8")
    )
    own = {
        name: Markup((HERE / f"map.{name}").read_text(encoding="utf-8")) for name in ("css", "js")
    }
    trials = " to ".join(f"{n:,}" for n in dict.fromkeys((counts[0], counts[-1])))
    return template.render(data=Markup(text), trials=trials, **own)
