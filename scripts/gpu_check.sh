#!/usr/bin/env bash
# Everything that only a card can show, in three parts of at most nine minutes:
#
#     scripts/gpu_check.sh [1|2|3] [FOLDER] [PACKED...]
#
# --help says what they do, what they need, and which files FOLDER gets. PYTHON names the interpreter.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
python=${PYTHON:-$([ -x "$root/.venv/bin/python" ] && echo "$root/.venv/bin/python" || echo python3)}
python=$(realpath -s "$(command -v "$python")") # -s: a virtual environment's link stays one
PYTHONPATH=$root${PYTHONPATH:+:$PYTHONPATH} PYTHONUNBUFFERED=1 exec "$python" -m benchmarks.gpu_check "$@"
