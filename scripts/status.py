"""``trl-explore status ...`` from a checkout: ``python scripts/status.py ...``."""

import sys

from trl_explore.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["status", *sys.argv[1:]]))
