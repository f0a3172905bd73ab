"""``trl-explore train ...`` from a checkout: ``python scripts/train.py ...``."""

import sys

from trl_explore.commands.main import main

if __name__ == "__main__":
    sys.exit(main(["train", *sys.argv[1:]]))
