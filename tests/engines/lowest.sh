#!/usr/bin/env bash
# Install the lowest version of every package that pyproject.toml allows, and run the tests.
#
#   tests/engines/lowest.sh [FOLDER [PYTEST-ARGUMENT...]]
#
# FOLDER (default build/lowest) keeps the environment; pytest runs all tests by default.
set -euo pipefail
cd "$(dirname "$0")/../.."
env=$(realpath -m "${1:-build/lowest}")
shift || true
if [ ! -e "$env/ready" ]; then
  rm -rf "$env"
  "${PYTHON:-python3}" -m venv "$env"
  "$env/bin/python" -m pip install --quiet uv
  links=()
  for link in ${PIP_FIND_LINKS:-}; do links+=(--find-links "$link"); done
  "$env/bin/uv" pip install --quiet --python "$env/bin/python" --resolution lowest-direct \
    ${links[@]+"${links[@]}"} '.[dev]'
  touch "$env/ready"
fi
"$env/bin/uv" pip list --python "$env/bin/python" 2>/dev/null |
  grep -iE '^(gymnasium|hydra-core|jinja2|matplotlib|numba|numpy|pandas|safetensors|scipy|tensordict|torch|torchrl) ' |
  sed 's/  */ /' | paste -sd ,
exec "$env/bin/python" -m pytest -p no:cacheprovider "$@"
