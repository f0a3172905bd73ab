#!/usr/bin/env bash
# A sweep on a Ray cluster of two nodes on this machine, one of which is killed midway.
#
#   tests/engines/ray.sh [FOLDER]    FOLDER (default build/ray) keeps the environment of its own
#
# Ray's launcher needs other versions of shared packages than the rest of the tests.
set -euo pipefail
cd "$(dirname "$0")/../.."
env=$(realpath -m "${1:-build/ray}")
if [ ! -e "$env/ready" ]; then
  rm -rf "$env"
  "${PYTHON:-python3}" -m venv "$env"
  "$env/bin/python" -m pip install --quiet '.[ray]' pytest || {
    echo "skipped: the extra ray cannot be installed here"
    exit 0
  }
  touch "$env/ready"
fi
exec "$env/bin/python" tests/engines/ray_nodes.py
