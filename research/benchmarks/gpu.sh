#!/bin/bash
# Measures a machine with a GPU in four minutes at most, and writes gpu.json.
#
#   research/benchmarks/gpu.sh [WHEELS [OUTPUT]]
#
# WHEELS: folder of wheels that the machine lacks, for one without a network:
#   python -m pip download --no-deps --only-binary :all: --python-version 3.12 -d WHEELS \
#     jaxtyping mujoco mujoco-core tyro typeguard docstring-parser
set -eu
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
output=${2:-gpu.json}
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
if [ -n "${1:-}" ]; then
  python3 -m pip install -q --no-index --no-deps --no-compile --target "$site" "$1"/*.whl
fi
export PYTHONPATH=$root/src:$root/research/src:$site${PYTHONPATH:+:$PYTHONPATH}
export PYTHONUNBUFFERED=1 XLA_PYTHON_CLIENT_PREALLOCATE=false
timeout 240 python3 "$here/gpu.py" --output "$output" --commit "${COMMIT:-$(git -C "$root" rev-parse --short HEAD)}"
