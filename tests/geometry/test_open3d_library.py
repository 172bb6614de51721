"""Open3D comes alone."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
import sys
from mgsr.open3d_library import load_open3d
mesh = load_open3d().geometry.TriangleMesh.create_box()
print(len(mesh.triangles), [name for name in ("dash", "flask", "plotly") if name in sys.modules])
"""


def test_no_web_server_and_no_plots_come_along() -> None:
    answer = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, timeout=120)
    assert answer.stdout == "12 []\n"
