"""Which configuration, environment and seed a run has, from the path of its folder.

CartPole-v1__ppo__3__1700000000    environment, configuration, seed and time (CleanRL)
ppo_CartPole-v1_3                  configuration, environment and seed (Stable-Baselines3)
lr=0.1,seed=3   env=Pong-v5        parts of a configuration, seed, environment (Hydra)
seed_3   seed3   s3   ppo-seed-3   a seed, by that name
PPO_3   CartPole-v1_1   run_3   3  the third run of a configuration, of unknown seed
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from trl_explore.jobs.files import ResultsError

SEED = re.compile(
    r"(?:^|[_.\- (,])(?:random_?seed|seed|s)(?:[_=\-]|:? )?(\d{1,19})(?=$|[_.\- ,)])", re.I
)
ENVIRONMENT = re.compile(
    r"(?:[A-Za-z]\w*[/:]|ALE-)?(?:[A-Z](?=[A-Z0-9]*[a-z])[A-Za-z0-9]*(?:-[A-Z0-9][A-Za-z0-9]*)*|[a-z]"
    r"[A-Za-z0-9]*)-v\d+"
)
"""``CartPole-v1``, ``ALE-Pong-v5``, ``MiniGrid-Empty-5x5-v0``, ``highway-v0``; not ``PPO-``."""
ENVIRONMENT_KEYS = ("env", "env_id", "env_name", "environment", "env.id", "env.name",
                    "env.env_name")  # fmt: skip
NUMBER = re.compile(r"(?:^|(?<!\de)[_\- ])(?:run|trial|exp)?[_\-]?(\d{1,4})$", re.I)
TIME = re.compile(
    r"(?:^|[_\-. ])(?:\d{4}-\d\d-\d\d(?:[_T -]\d\d[-:]\d\d(?:[-:]\d\d\w{0,8})?)?|\d\d-\d\d-\d\d"
    r"|20\d{6}(?:[-_T]?\d{6})?|1\d{9})"
    r"(?=$|[_\-. ])"
)
"""Dates and times, which say nothing about a configuration."""
RAY = re.compile(r"_(?:[0-9a-f]{5,8}_\d{5}(?:_\d+)?(?:_|$)|\d{1,5}_(?=\w+=))")
"""The identifier, or number, of a trial of Ray Tune, between the names and the parameters."""


@dataclass
class Identity:
    """Whose run it is: parts that describe its configuration, outermost folder first; its seed."""

    parts: list[str] = field(default_factory=list)
    environment: str = ""
    seed: int | None = None

    def take_seed(self, text: str) -> bool:
        """Set the seed from digits; whether the text is a seed."""
        if not re.fullmatch(r"\d{1,18}", text.strip()):
            return False
        self.seed = int(text)
        return True


def identify(place: str, facts: Mapping[str, str]) -> Identity:
    """The identity of a run, from its path and what its files say.

    >>> run = identify("runs/CartPole-v1__ppo__3__1700000000", {})
    >>> run.parts, run.environment, run.seed
    (['runs', 'ppo'], 'CartPole-v1', 3)
    >>> run = identify("PPO_CartPole-v1_3", {})
    >>> run.parts, run.environment, run.seed
    (['PPO'], 'CartPole-v1', 3)
    """
    found = Identity()
    path = [*place.split("/"), *([facts["overrides"]] if "overrides" in facts else [])]
    for component in [] if "configuration" in facts else path:
        _component(component, found)
    if "configuration" in facts:
        found.parts = [facts["configuration"]]
    found.environment = facts.get("environment", found.environment)
    if "seed" in facts:
        found.seed = None
        found.take_seed(facts["seed"].removesuffix(".0"))
    return found


def identify_by(pattern: re.Pattern[str], place: str, facts: Mapping[str, str]) -> Identity:
    """The identity by a pattern with groups ``configuration``, ``environment`` and ``seed``.

    Raises:
        ResultsError: the pattern does not occur in the path.
    """
    match = pattern.search(place)
    if match is None:
        raise ResultsError(f"--pattern {pattern.pattern!r} does not occur in {place!r}")
    named = {name: text for name, text in match.groupdict().items() if text is not None}
    return identify(place, dict(facts) | named)


def _component(text: str, found: Identity) -> None:
    words = text.split("__")
    if len(words) >= 3 and words[-2 if len(words) > 3 else -1].isdigit():
        found.environment, name, seed = words[0], "__".join(words[1:-2]) or words[1], words[2]
        found.take_seed(words[-2] if len(words) > 3 else seed)
        found.parts.append(name)
        return
    text = TIME.sub("", RAY.sub(",", text))
    kept = []
    for word in re.split(r",(?![^\[]*\])", text):
        key, equals, value = word.partition("=")
        if equals and key.split(".")[-1].lower() in ("seed", "random_seed"):
            if not found.take_seed(value):
                kept.append(word)
        elif equals and key.lower() in ENVIRONMENT_KEYS:
            found.environment = value
        else:
            kept.append(word if equals else _words(word, found))
    if rest := ", ".join(word for word in kept if word):
        found.parts.append(rest)


def _words(text: str, found: Identity) -> str:
    """What of a word describes the configuration."""
    if seed := SEED.search(text):
        found.take_seed(seed[1])
        text = text[: seed.start()] + text[seed.end() :]
    environment = ENVIRONMENT.search(text)
    if environment:
        found.environment = environment[0]
        before, after = text[: environment.start()], text[environment.end() :]
        if before.strip("_- ") and found.seed is None and re.fullmatch(r"[_\-]\d+", after):
            found.take_seed(after[1:])
            after = ""
        text = f"{before.rstrip('_- ')}{after}"
    return NUMBER.sub("", text).strip("_-., ()")


def labels(identities: Sequence[Identity]) -> list[str]:
    """A name of the configuration of each run: the parts that not all runs have in common.

    >>> labels([Identity(["logs", "ppo"]), Identity(["logs", "a2c"])])
    ['ppo', 'a2c']
    """
    shared = set.intersection(*(set(i.parts) for i in identities)) if identities else set()
    names = []
    for identity in identities:
        own = [part for part in identity.parts if part not in shared]
        names.append(", ".join(own) or (identity.parts[-1] if identity.parts else "all runs"))
    return names
