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
    """The paths of the files in a folder of results (docs/outputs.md). Files that a run has not written do not exist:
    without a flash there is no `flash.npz`."""

    folder: Path

    @property
    def mesh(self) -> Path:
        """mesh.ply."""
        return self.folder / MESH

    @property
    def mesh_obj(self) -> Path:
        """mesh.obj, if it was asked for."""
        return self.folder / MESH_OBJ

    @property
    def model_glb(self) -> Path:
        """model.glb, the textured model, y up."""
        return self.folder / MODEL_GLB

    @property
    def model_usdz(self) -> Path:
        """model.usdz, if it was asked for."""
        return self.folder / MODEL_USDZ

    @property
    def environment(self) -> Path:
        """environment.exr, the light about the surface, in the frame of model.glb, where it is known."""
        return self.folder / ENVIRONMENT

    @property
    def surfels(self) -> Path:
        """splats_2d.ply, the 2D branch."""
        return self.folder / SURFELS

    @property
    def gaussians(self) -> Path:
        """splats_3d.ply, the 3D branch."""
        return self.folder / GAUSSIANS

    @property
    def background(self) -> Path:
        """splats_background.ply, what lies around a found object."""
        return self.folder / BACKGROUND

    @property
    def environment_map(self) -> Path:
        """mirrored_light.npz, where a shiny surface reflects an environment map."""
        return self.folder / ENVIRONMENT_MAP

    @property
    def flash(self) -> Path:
        """flash.npz, where the camera had one."""
        return self.folder / FLASH

    @property
    def exposures(self) -> Path:
        """exposures.json, where the photographs' exposures differ."""
        return self.folder / EXPOSURES

    @property
    def object(self) -> Path:
        """object.json, where an object was asked for and found."""
        return self.folder / OBJECT

    @property
    def masks(self) -> Path:
        """masks, the folder of the found object's masks."""
        return self.folder / MASKS

    @property
    def renders(self) -> Path:
        """renders/test, the folder of the test views' pictures."""
        return self.folder / RENDERS

    @property
    def report(self) -> Path:
        """report.json."""
        return self.folder / REPORT

    @property
    def report_html(self) -> Path:
        """report.html."""
        return self.folder / REPORT_HTML

    @property
    def log(self) -> Path:
        """log.txt."""
        return self.folder / LOG

    @property
    def checkpoint(self) -> Path:
        """checkpoint, from which a run goes on."""
        return self.folder / CHECKPOINT

    @property
    def cameras(self) -> Path:
        """cameras, where photographs had none: the found ones, as COLMAP has them, and the frames of a video."""
        return self.folder / CAMERAS
