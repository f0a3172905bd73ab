"""Check, name and build jobs from a Hydra configuration; each error is one line.

Only this package and the commands use Hydra and OmegaConf. It imports torch only to build a job, so
that ``--help``, ``--cfg`` and tab completion are fast.
"""

from trl_explore.checks import first_line
from trl_explore.config.building import build_shards, build_trainer, fill_threshold
from trl_explore.config.checking import check_keys, describe, differences, resolved, unreadable
from trl_explore.config.files import CONF, GROUPS, INERT, ConfigError, files_of, search_in
from trl_explore.config.naming import job_name, register_resolvers
from trl_explore.config.objective import best, measured, objective, returned
from trl_explore.config.sweeping import (
    Ended,
    collect,
    current_choices,
    current_folder,
    end_job,
    is_multirun,
    is_repeated,
    is_worker,
    save_hydra,
)

__all__ = [
    "CONF",
    "GROUPS",
    "INERT",
    "ConfigError",
    "Ended",
    "best",
    "build_shards",
    "build_trainer",
    "check_keys",
    "collect",
    "current_choices",
    "current_folder",
    "describe",
    "differences",
    "end_job",
    "files_of",
    "fill_threshold",
    "first_line",
    "is_multirun",
    "is_repeated",
    "is_worker",
    "job_name",
    "measured",
    "objective",
    "register_resolvers",
    "resolved",
    "returned",
    "save_hydra",
    "search_in",
    "unreadable",
]
