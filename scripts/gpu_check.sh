#!/usr/bin/env bash
# Everything that only a card can show, in one command:
#
#     scripts/gpu_check.sh [FOLDER] [PACKED_SCENE]
#
# FOLDER gets the results ($OUT or out/gpu_check by default): summary.txt, log.txt, tests.txt, sanitizer.txt, benchmark.md,
# training/. PACKED_SCENE is what `benchmarks/cuda_training.py pack` wrote; without it, the ball of the
# tests is trained. PYTHON names the interpreter, which must have torch for CUDA, numpy, SciPy, pytest, plyfile, cuda-core
# and an NVRTC; the CPU kernels are built where they are missing, which takes cmake, ninja, nanobind and a C++ compiler. gsplat
# is measured where it can be imported. PRESET (high) and RUNS (20) change the training and the benchmark; SKIP, a list of
# steps (build kernels tests sanitizer benchmark training), leaves some out.
#
# A step that fails does not stop the others; the exit code says whether all went well.
set -uo pipefail
cd "$(dirname "$0")/.."
results=${1:-${OUT:-out/gpu_check}}
scene=${2:-}
python=${PYTHON:-$([ -x .venv/bin/python ] && echo .venv/bin/python || echo python3)}
python=$(realpath -s "$(command -v "$python")")  # -s: a virtual environment's link stays one
mkdir -p "$results/training"
results=$(cd "$results" && pwd)
# The interpreter's cmake and ninja, and the toolkit's compute-sanitizer, which images leave out of the path.
export PATH=$(dirname "$python"):$PATH:/usr/local/cuda/bin
export PYTHONPATH=$PWD PYTHONUNBUFFERED=1
: >"$results/summary.txt"
: >"$results/log.txt"
failed=0

step() { # NAME FILE COMMAND...
  local name=$1 file=$2 begin=$SECONDS status=ok
  shift 2
  case " ${SKIP:-} " in *" $name "*)
    echo "$name: left out" | tee -a "$results/summary.txt"
    return
    ;;
  esac
  "$@" >>"$results/$file" 2>&1 || { status="FAILED (exit code $?)" && failed=1; }
  echo "$name: $status, $((SECONDS - begin)) s, $file" | tee -a "$results/summary.txt"
}

facts() {
  git log -1 --format='commit %h of %cs' || true
  nvidia-smi --query-gpu=name,driver_version,memory.total,compute_cap --format=csv
  "$python" - <<'PY'
import importlib.metadata as metadata
import torch
from mgsr.native.cuda.launcher import compiler_version, cuda_launcher
print("torch", torch.__version__, "for CUDA", torch.version.cuda, "- NVRTC", *compiler_version())
for name in ("cuda-core", "cuda-bindings", "gsplat"):
    try:
        print(name, metadata.version(name))
    except metadata.PackageNotFoundError:
        print(name, "is not installed")
cuda_launcher(0)
PY
}

build() {
  "$python" -c "import mgsr.native.runtime" 2>/dev/null && echo "the CPU kernels are there" && return
  cmake -S . -B build/gpu_check -G Ninja -DCMAKE_BUILD_TYPE=Release -DPython_EXECUTABLE="$python" &&
    cmake --build build/gpu_check && "$python" -c "import mgsr.native.runtime"
}

kernels() { # compiled for this card, timed
  "$python" - <<'PY'
import time
from mgsr.native.cuda.compiler import SOURCES, arch_for, compile_family
import torch
arch = arch_for(*torch.cuda.get_device_capability())
for path in sorted(SOURCES.glob("kernels/*/*.cu")):
    begin = time.perf_counter()
    size = len(compile_family(path.stem, arch))
    print(f"{path.stem} for {arch}: {size} bytes, {time.perf_counter() - begin:.2f} s")
PY
}

# Without the compilations for every other generation, which CI has.
tests() { "$python" -m pytest tests/cuda -ra -k "not test_compiles"; }

sanitizer() {
  command -v compute-sanitizer >/dev/null || { echo "compute-sanitizer is not installed; SKIP=sanitizer leaves it out" && return 1; }
  local tool code=0
  for tool in memcheck racecheck synccheck; do
    echo "== $tool"
    # Without torch's cache, each tensor is an allocation of its own, so that reading past one shows.
    PYTORCH_NO_CUDA_MEMORY_CACHING=1 compute-sanitizer --tool "$tool" --error-exitcode 9 --target-processes all \
      "$python" -m pytest -q -x tests/cuda -k "cuda] and not training and not reference" || code=1
  done
  return $code
}

benchmark() {
  "$python" benchmarks/cuda.py --runs "${RUNS:-20}" >"$results/benchmark.md"
  local code=$?
  cat "$results/benchmark.md"
  return $code
}

training() {
  local packed=$scene
  if [ -z "$packed" ]; then
    packed=$results/training/ball.npz
    "$python" benchmarks/cuda_training.py pack ball "$packed" || return
  fi
  "$python" benchmarks/cuda_training.py run "$packed" "$results/training" --preset "${PRESET:-high}" --profile 100
}

step facts log.txt facts
step build log.txt build
step kernels log.txt kernels
step tests tests.txt tests
step sanitizer sanitizer.txt sanitizer
step benchmark log.txt benchmark
step training log.txt training
[ -z "$scene" ] && rm -f "$results/training/ball.npz"
exit $failed
