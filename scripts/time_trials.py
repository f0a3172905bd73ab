"""``trl-explore time ...`` from a checkout: ``python scripts/time_trials.py ...``."""

import sys

from trl_explore.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["time", *sys.argv[1:]]))
