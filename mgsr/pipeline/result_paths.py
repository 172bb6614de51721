"""The names of the files in a folder of results."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mgsr.data.object_place import OBJECT_FILE

MESH = "mesh.ply"
MESH_OBJ = "mesh.obj"
MODEL_GLB = "model.glb"
LEVEL_GLB = "model_lod{}.glb"
MODEL_USDZ = "model.usdz"
MODEL_DRACO = "model_draco.glb"
ENVIRONMENT = "environment.exr"
SURFELS = "splats_2d.ply"
GAUSSIANS = "splats_3d.ply"
BACKGROUND = "splats_background.ply"
ENVIRONMENT_MAP = "mirrored_light.npz"
FLASH = "flash.npz"
EXPOSURES = "exposures.json"
ADJUSTED_CAMERAS = "adjusted_cameras.json"
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

    Files that a run has not written do not exist.
    """

    folder: Path

    @property
    def mesh(self) -> Path:
        """Return the path of mesh.ply."""
        return self.folder / MESH

    @property
    def mesh_obj(self) -> Path:
        """Return the path of mesh.obj, which exists if it was requested."""
        return self.folder / MESH_OBJ

    @property
    def model_glb(self) -> Path:
        """Return the path of model.glb: the textured model, y up."""
        return self.folder / MODEL_GLB

    def model_level(self, level: int) -> Path:
        """Return the path of a level of detail of the textured model: 0 is model.glb, 1 model_lod1.glb and so on."""
        return self.folder / (LEVEL_GLB.format(level) if level else MODEL_GLB)

    @property
    def model_usdz(self) -> Path:
        """Return the path of model.usdz, which exists if it was requested."""
        return self.folder / MODEL_USDZ

    @property
    def model_draco(self) -> Path:
        """Return the path of model_draco.glb, the compressed model, which exists if it was requested."""
        return self.folder / MODEL_DRACO

    @property
    def environment(self) -> Path:
        """Return the path of environment.exr: the light around the surface, in the frame of model.glb."""
        return self.folder / ENVIRONMENT

    @property
    def surfels(self) -> Path:
        """Return the path of splats_2d.ply: the 2D branch."""
        return self.folder / SURFELS

    @property
    def gaussians(self) -> Path:
        """Return the path of splats_3d.ply: the 3D branch."""
        return self.folder / GAUSSIANS

    @property
    def background(self) -> Path:
        """Return the path of splats_background.ply: the surroundings of a found object."""
        return self.folder / BACKGROUND

    @property
    def environment_map(self) -> Path:
        """Return the path of mirrored_light.npz: the environment map that a shiny surface reflects."""
        return self.folder / ENVIRONMENT_MAP

    @property
    def flash(self) -> Path:
        """Return the path of flash.npz: the flash and the surface that it lights."""
        return self.folder / FLASH

    @property
    def adjusted_cameras(self) -> Path:
        """Return the path of adjusted_cameras.json: the photographs' cameras, if they were adjusted."""
        return self.folder / ADJUSTED_CAMERAS

    @property
    def exposures(self) -> Path:
        """Return the path of exposures.json: the photographs' exposures, if they differ."""
        return self.folder / EXPOSURES

    @property
    def object(self) -> Path:
        """Return the path of object.json: the place of a found object."""
        return self.folder / OBJECT

    @property
    def masks(self) -> Path:
        """Return the path of masks: the folder of the found object's masks."""
        return self.folder / MASKS

    @property
    def renders(self) -> Path:
        """Return the path of renders/test: the folder of the test views' pictures."""
        return self.folder / RENDERS

    @property
    def report(self) -> Path:
        """Return the path of report.json."""
        return self.folder / REPORT

    @property
    def report_html(self) -> Path:
        """Return the path of report.html."""
        return self.folder / REPORT_HTML

    @property
    def log(self) -> Path:
        """Return the path of log.txt."""
        return self.folder / LOG

    @property
    def checkpoint(self) -> Path:
        """Return the path of the checkpoint, from which a run resumes."""
        return self.folder / CHECKPOINT

    @property
    def cameras(self) -> Path:
        """Return the path of cameras, the folder of cameras that a run found, and of a video's frames."""
        return self.folder / CAMERAS
