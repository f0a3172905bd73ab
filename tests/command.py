"""``trl-explore COMMAND ...`` as a script."""

import sys

from trl_explore.commands.main import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
