"""Check, name and build jobs from a Hydra configuration; each error is one line.

Only this package and the commands use Hydra and OmegaConf. It imports torch only to build a job, so
that ``--help``, ``--cfg`` and tab completion are fast.
"""

from trl_explore.config.building import build_shards, build_trainer, fill_threshold
from trl_explore.config.checking import (
    ERRORS,
    check_keys,
    describe,
    differences,
    resolved,
    unreadable,
)
from trl_explore.config.files import CONF, GROUPS, INERT, ConfigError, files_of
from trl_explore.config.job_names import job_name, register_resolvers

__all__ = [
    "CONF",
    "ERRORS",
    "GROUPS",
    "INERT",
    "ConfigError",
    "build_shards",
    "build_trainer",
    "check_keys",
    "describe",
    "differences",
    "files_of",
    "fill_threshold",
    "job_name",
    "register_resolvers",
    "resolved",
    "unreadable",
]
