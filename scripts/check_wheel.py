"""Check an installed wheel: load every extension, run a kernel, and find and read the example."""

from __future__ import annotations

import torch

import mgsr
from mgsr.native.runtime import FAMILIES, isas
from mgsr.ops.depth_normals import depth_to_normals
from mgsr.pipeline.example import find_example

scene = mgsr.load_scene(find_example())
camera = scene.train[0].camera
normals = depth_to_normals(torch.full((camera.height, camera.width), 2.0), camera)
expected = torch.from_numpy(-camera.cam_from_world[2, :3]).float()  # a plane of constant depth faces the camera
if not torch.allclose(normals[5, 5], expected, atol=1e-5):
    raise SystemExit(f"normal of a plane: expected {expected.tolist()}, got {normals[5, 5].tolist()}")
print(f"{len(FAMILIES)} extensions, variants {' '.join(isas())}; {len(scene.train)} training views")
