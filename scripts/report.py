"""``trl-explore report ...`` from a checkout: ``python scripts/report.py ...``."""

import sys

from trl_explore.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["report", *sys.argv[1:]]))
