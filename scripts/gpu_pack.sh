#!/usr/bin/env bash
# Collect what scripts/gpu_check.sh needs on a bare machine as PACKED, under 64 MB: the scenes that it trains, and wheels.
#
#     scripts/gpu_pack.sh FOLDER [--data DATA]
#
# DATA has the scenes; the default is ../shared/data beside the checkout. Existing files in FOLDER are kept.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
PYTHONPATH=$root${PYTHONPATH:+:$PYTHONPATH} exec "${PYTHON:-$root/.venv/bin/python}" -m benchmarks.cuda_training \
  pack-all "$@"
