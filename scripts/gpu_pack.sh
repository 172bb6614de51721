#!/usr/bin/env bash
# What scripts/gpu_check.sh takes to a bare machine as PACKED, under 64 MB: the scenes that it trains, and wheels.
#
#     scripts/gpu_pack.sh FOLDER [--data DATA]
#
# DATA (../shared/data beside the checkout) has the scenes. What is in FOLDER already stays.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
PYTHONPATH=$root${PYTHONPATH:+:$PYTHONPATH} exec "${PYTHON:-$root/.venv/bin/python}" -m benchmarks.cuda_training \
  pack-all "$@"
