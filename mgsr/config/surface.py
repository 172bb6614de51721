"""How the mesh is made, and which files a run writes."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Extractor(StrEnum):
    """poisson: screened Poisson on oriented points; tsdf: fusion of depth maps (the paper's)."""

    POISSON = "poisson"
    TSDF = "tsdf"


class MeshColor(StrEnum):
    """The mesh's vertex colours: transmitted, without the highlights; full, the mean of all that the views show."""

    TRANSMITTED = "transmitted"
    FULL = "full"


@dataclass(frozen=True)
class MeshConfig:
    """How the surface is taken from the 2D branch. A footprint is what a pixel of the rendered views covers there."""

    extractor: Extractor = Extractor.POISSON
    view_scale: float = 2.0  # size of the rendered views against the photographs
    max_pixels: int = 16_000_000  # of all rendered views together; they are made smaller to keep to it
    extra_views: int = 0  # views rendered halfway between training views
    min_alpha: float = 0.5  # pixels under it show no surface
    min_cos: float = 0.3  # pixels seen at a more grazing angle are dropped
    max_jump: float | None = 3.0  # footprints off a neighbour's plane at which a pixel counts as blended; none is off
    radius: float | None = 1.25  # what lies farther from the scene's centre is dropped; none is off
    consistency: float | None = 3.0  # footprints in front of another view's surface that are forgiven; none is off
    hull_margin: float | None = 1.0  # pixels outside a photograph's silhouette that are forgiven; none is off
    hull_reach: float = 4.0  # footprints that vertices are pulled into the silhouettes at most; others are cut off
    silhouette_smoothing: float | None = 1.0  # pixels over which corrections of the contours spread; none is off
    poisson_depth: int = 8  # of the octree; its finest cell is 1.1 / 2^depth of the object's longest side
    cell: float = 0.6  # octree cells in which points are averaged into one
    trim: float = 3.0  # octree cells from the nearest point at which Poisson's surface is cut
    max_light_residual: float | None = 0.85  # shading refines the mesh where a flash on the camera, or an environment
    # map, leaves at most this share of the residual that one brightness a point leaves; none is off, for photometric
    # refinement too
    photometric_reach: float | None = 8.0  # pixels over which photometric refinement spreads a displacement, where
    # shading is looked at and masks hold the silhouettes; none is off
    photometric_residual: float | None = 0.022  # sRGB 0..1; where photographs under a flash differ by more about a
    # place, beyond what a surface that is 0.7 pixels off explains, it is left open; none, or close_holes, keeps all
    regression_angle: float | None = 4.0  # degrees; local regression takes normals that differ by less within a few
    # pixels for waves, by much more for a crease, unless a flash has fixed them; none and 0 are off
    bilateral_angle: float | None = 17.0  # degrees; the bilateral filter takes normals of neighbouring facets that
    # differ by less for noise, by much more for a crease; none and 0 are off
    voxel: float = 2.0  # footprints in a voxel of the TSDF
    truncation: float = 3.0  # voxels before and behind the surface that the TSDF reaches
    min_weight: float = 2.0  # views in which a voxel of the TSDF must be seen
    min_piece: float = 0.01  # connected pieces under this share of the area are dropped
    close_holes: bool = False  # keep what Poisson invents where nothing was seen
    max_faces: int | None = None  # decimate to this many; none is off
    color: MeshColor = MeshColor.TRANSMITTED


class Up(StrEnum):
    """Which axis of the capture's frame points up: y, z, -y, -z, or auto, what most photographs have as their upper
    side. .glb files are y up, and are turned to it."""

    AUTO = "auto"
    Y = "y"
    Z = "z"
    MINUS_Y = "-y"
    MINUS_Z = "-z"


@dataclass(frozen=True)
class OutputConfig:
    """Which files are written, and in which unit and pose."""

    scale: float = 1.0  # what all lengths in the written files are multiplied with; 1 is the capture's own unit
    up: Up = Up.AUTO
    obj: bool = False  # mesh.obj too
    usdz: bool = False  # model.usdz too, for Apple's devices; needs the package usd-core
    faces: int | None = 100_000  # decimate model.glb to this many, as its maps show the rest; none keeps all
    texture: int | None = None  # texels along a side of model.glb's maps; none makes a texel as large as a pixel
