#!/usr/bin/env bash
# Install the program for every Python from 3.11 to 3.14 that is found; run the golden run and a few
# tests under each; and run the job of the first again under each, also as a generic processor would.
#
#   tests/engines/pythons.sh [FOLDER]    FOLDER (default build/pythons) keeps the environments
#   PYTHONS="python3.12 python3.14" tests/engines/pythons.sh
set -euo pipefail
cd "$(dirname "$0")/../.."
folder=$(realpath -m "${1:-build/pythons}")
tests=(tests/test_golden.py tests/test_core.py tests/strategies/test_every_*.py
  tests/numerics/test_twins.py tests/jobs/test_writing.py tests/jobs/test_reading.py tests/jobs/test_resume.py
  tests/commands/test_verify.py tests/report/test_render.py)
job=(experiment=debug trials=20 max_iterations=200 score_window=100 score_threshold=400 threads=2)

mkdir -p "$folder"
[ -e "$folder/uv/bin/uv" ] || { python3 -m venv "$folder/uv"; "$folder/uv/bin/pip" install --quiet uv; }

first=
for name in ${PYTHONS:-python3.11 python3.12 python3.13 python3.14}; do
  if ! version=$("$name" -c 'import platform; print(platform.python_version())' 2>/dev/null); then
    echo "$name: not found"
    continue
  fi
  env=$folder/$version
  if [ ! -e "$env/ready" ]; then
    rm -rf "$env"
    "$name" -m venv "$env"
    "$folder/uv/bin/uv" pip install --quiet --python "$env/bin/python" \
      --constraint constraints.txt '.[lab]' pytest hypothesis
    touch "$env/ready"
  fi
  said=$("$env/bin/python" -m pytest -q -p no:cacheprovider "${tests[@]}" 2>&1) || {
    echo "$said"
    echo "Python $version: tests failed"
    exit 1
  }
  rm -rf "$env/jobs"
  "$env/bin/trl-explore" train "${job[@]}" output_dir="$env/jobs" >/dev/null
  first=${first:-$env/jobs}
  same=$("$env/bin/trl-explore" verify "$first")
  older=$(env NUMBA_CPU_NAME=generic ATEN_CPU_CAPABILITY=default \
    GLIBC_TUNABLES=glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F "$env/bin/trl-explore" verify "$first")
  echo "Python $version: ${said##*$'\n'}"
  echo "  the job of the first Python: ${same##*: }; compiled for a generic processor: ${older##*: }"
done
[ -n "$first" ] || { echo "no Python from 3.11 to 3.14 was found"; exit 1; }
