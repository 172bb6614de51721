#!/usr/bin/env bash
# Run all checks that need a GPU, in three parts of at most nine minutes:
#
#     scripts/gpu_check.sh [1|2|3] [FOLDER] [PACKED...]
#
# --help describes the parts, their requirements, and the files that they write to FOLDER. PYTHON names the interpreter.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
python=${PYTHON:-$([ -x "$root/.venv/bin/python" ] && echo "$root/.venv/bin/python" || echo python3)}
python=$(realpath -s "$(command -v "$python")") # -s keeps the link of a virtual environment
PYTHONPATH=$root${PYTHONPATH:+:$PYTHONPATH} PYTHONUNBUFFERED=1 exec "$python" -m benchmarks.gpu_check "$@"
