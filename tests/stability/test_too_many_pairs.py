"""More pairs of splats and tiles than the CPU's 32-bit places hold; `tests/cuda` has the GPU's refusal."""

from __future__ import annotations

import subprocess
from pathlib import Path

NATIVE = Path(__file__).parents[2] / "mgsr" / "native"

# Counts as a scene would leave them that no memory holds.
PROGRAM = """
#include <cstdio>
#include "kernels/common/binning.h"
int main() {
  mgsr::TileLists lists;
  lists.found.resize(2), lists.chunk_slots.resize(2);
  lists.found[0].count = lists.found[1].count = 1u << 31;
  try {
    mgsr::baseline::number_slots(lists);
  } catch (const std::length_error& error) {
    std::puts(error.what());
    return 0;
  }
  return 1;
}
"""


def test_more_than_32_bits_are_refused(tmp_path: Path) -> None:
    """Check that more pairs than 32 bits hold are refused before anything is allocated.

    The message says what is too many, and the cure.
    """
    source, program = tmp_path / "pairs.cpp", tmp_path / "pairs"
    source.write_text(PROGRAM)
    flags = ["-std=gnu++17", "-O0", "-DMGSR_ISA=baseline", "-Wno-psabi", "-pthread", "-I", str(NATIVE)]
    subprocess.run(["g++", *flags, str(source), "-o", str(program)], check=True)
    done = subprocess.run([program], check=True, capture_output=True, text=True)
    assert "2^32 pairs of splats and tiles" in done.stdout and "smaller" in done.stdout
