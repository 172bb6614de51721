"""The names of the files in a folder of results."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mgsr.data.object_place import OBJECT_FILE

MESH = "mesh.ply"
MESH_OBJ = "mesh.obj"
MODEL_GLB = "model.glb"
MODEL_USDZ = "model.usdz"
ENVIRONMENT = "environment.exr"
SURFELS = "splats_2d.ply"
GAUSSIANS = "splats_3d.ply"
BACKGROUND = "splats_background.ply"
ENVIRONMENT_MAP = "mirrored_light.npz"
FLASH = "flash.npz"
EXPOSURES = "exposures.json"
OBJECT = OBJECT_FILE
MASKS = "masks"
RENDERS = "renders/test"
REPORT = "report.json"
REPORT_HTML = "report.html"
LOG = "log.txt"
ESTIMATE = "estimate.json"
CHECKPOINT = "checkpoint"
CAMERAS = "cameras"


@dataclass(frozen=True)
class ResultPaths:
    """The paths of the files in a folder of results (docs/outputs.md).

    Files that a run has not written do not exist. For example, a capture without a flash has no `flash.npz`.
    """

    folder: Path

    @property
    def mesh(self) -> Path:
        """Return the path of mesh.ply, the full surface with vertex colours."""
        return self.folder / MESH

    @property
    def mesh_obj(self) -> Path:
        """Return the path of mesh.obj, which exists if the settings asked for it."""
        return self.folder / MESH_OBJ

    @property
    def model_glb(self) -> Path:
        """Return the path of model.glb, the textured model, y up."""
        return self.folder / MODEL_GLB

    @property
    def model_usdz(self) -> Path:
        """Return the path of model.usdz, which exists if the settings asked for it."""
        return self.folder / MODEL_USDZ

    @property
    def environment(self) -> Path:
        """Return the path of environment.exr: the light around the surface, in model.glb's frame, if it is known."""
        return self.folder / ENVIRONMENT

    @property
    def surfels(self) -> Path:
        """Return the path of splats_2d.ply, the 2D branch."""
        return self.folder / SURFELS

    @property
    def gaussians(self) -> Path:
        """Return the path of splats_3d.ply, the 3D branch."""
        return self.folder / GAUSSIANS

    @property
    def background(self) -> Path:
        """Return the path of splats_background.ply, the Gaussians around a found object."""
        return self.folder / BACKGROUND

    @property
    def environment_map(self) -> Path:
        """Return the path of mirrored_light.npz, the environment map that a shiny surface reflects."""
        return self.folder / ENVIRONMENT_MAP

    @property
    def flash(self) -> Path:
        """Return the path of flash.npz, which exists if a flash lit the photographs."""
        return self.folder / FLASH

    @property
    def exposures(self) -> Path:
        """Return the path of exposures.json, which exists if the photographs' exposures differ."""
        return self.folder / EXPOSURES

    @property
    def object(self) -> Path:
        """Return the path of object.json, which exists if an object was looked for and found."""
        return self.folder / OBJECT

    @property
    def masks(self) -> Path:
        """Return the path of masks, the folder of a found object's masks."""
        return self.folder / MASKS

    @property
    def renders(self) -> Path:
        """Return the path of renders/test, the folder of the test views' pictures."""
        return self.folder / RENDERS

    @property
    def report(self) -> Path:
        """Return the path of report.json, which a run writes last."""
        return self.folder / REPORT

    @property
    def report_html(self) -> Path:
        """Return the path of report.html, the report for readers."""
        return self.folder / REPORT_HTML

    @property
    def log(self) -> Path:
        """Return the path of log.txt, the lines of the run."""
        return self.folder / LOG

    @property
    def checkpoint(self) -> Path:
        """Return the path of checkpoint, from which a run resumes."""
        return self.folder / CHECKPOINT

    @property
    def cameras(self) -> Path:
        """Return the path of cameras, the folder of found cameras in COLMAP's format and of a video's frames.

        It exists if the capture had no cameras.
        """
        return self.folder / CAMERAS
