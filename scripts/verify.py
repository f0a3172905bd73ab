"""``trl-explore verify ...`` from a checkout: ``python scripts/verify.py ...``."""

import sys

from trl_explore.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["verify", *sys.argv[1:]]))
