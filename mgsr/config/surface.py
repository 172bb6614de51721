"""How the mesh is made, and which files a run writes."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Extractor(StrEnum):
    """How the mesh is extracted.

    poisson: screened Poisson reconstruction from oriented points. tsdf: fusion of depth maps, as in the paper.
    """

    POISSON = "poisson"
    TSDF = "tsdf"


class MeshColor(StrEnum):
    """What the vertex colours show.

    transmitted: the object's own colour, without highlights. full: the mean of all that the views show.
    """

    TRANSMITTED = "transmitted"
    FULL = "full"


@dataclass(frozen=True)
class MeshConfig:
    """How the surface is extracted from the 2D branch and refined.

    A footprint is the size of a rendered pixel on the surface.
    """

    extractor: Extractor = Extractor.POISSON
    view_scale: float = 2.0  # The size of the rendered views, relative to the photographs.
    # The most pixels of all rendered views together. Views are made smaller to stay below it.
    max_pixels: int = 16_000_000
    extra_views: int = 0  # The number of additional views, rendered halfway between training views.
    min_alpha: float = 0.5  # Pixels with an alpha below this show no surface.
    min_cos: float = 0.3  # Pixels are dropped if normal and line of sight have a cosine below this.
    # A pixel more than this many footprints off a neighbour's plane counts as blended and is dropped. none: off.
    max_jump: float | None = 3.0
    radius: float | None = 1.25  # Points farther than this from the scene's centre are dropped. none: off.
    # Points more than this many footprints in front of another view's surface are dropped. none: off.
    consistency: float | None = 3.0
    hull_margin: float | None = 1.0  # Points more than this many pixels outside a silhouette are dropped. none: off.
    # Vertices are pulled into the silhouettes by at most this many footprints. Others are cut off.
    hull_reach: float = 4.0
    # Silhouette corrections are smoothed over this many pixels. none: no correction.
    silhouette_smoothing: float | None = 1.0
    poisson_depth: int = 8  # The depth of the octree. Its finest cell is 1.1 / 2^depth of the object's longest side.
    cell: float = 0.6  # The size of the cells in which points are averaged, in octree cells.
    trim: float = 3.0  # Poisson's surface is cut off this far from the nearest point, in octree cells.
    # Shading refines the mesh if a flash or an environment map leaves at most this share of the residual that constant
    # brightness leaves. none: neither shape from shading nor photometric refinement.
    max_light_residual: float | None = 0.85
    # Photometric refinement smooths displacements over this many pixels. It needs masks and max_light_residual.
    # none: off.
    photometric_reach: float | None = 6.0
    # Patches are removed if photographs under a flash differ by more than this (sRGB 0..1), beyond what a surface
    # error of 0.7 pixels explains. none or close_holes: off.
    photometric_residual: float | None = 0.022
    # Local regression smooths vertex normals that differ by fewer degrees than this within a few pixels, and keeps
    # sharper creases. It is skipped if a flash has fixed the normals. none or 0: off.
    regression_angle: float | None = 4.0
    # The bilateral filter smooths normals of neighbouring faces that differ by fewer degrees than this, and keeps
    # sharper creases. none or 0: off.
    bilateral_angle: float | None = 17.0
    voxel: float = 2.0  # The size of a TSDF voxel, in footprints.
    truncation: float = 3.0  # The truncation distance of the TSDF, in voxels.
    min_weight: float = 2.0  # TSDF voxels that fewer views than this see stay empty.
    min_piece: float = 0.01  # Connected pieces with less than this share of the area are dropped.
    # The mesh keeps the surface that Poisson reconstruction adds where no view shows one.
    close_holes: bool = False
    max_faces: int | None = None  # The mesh is decimated to this many faces. none: off.
    color: MeshColor = MeshColor.TRANSMITTED


class Up(StrEnum):
    """The axis of the capture's frame that points up: y, z, -y or -z.

    auto: the axis nearest to the upper side of most photographs. .glb files are turned to y.
    """

    AUTO = "auto"
    Y = "y"
    Z = "z"
    MINUS_Y = "-y"
    MINUS_Z = "-z"


MIN_TEXTURE = 16  # texels along a side of a map
MAX_LODS = 8  # coarser levels of detail; each has a quarter of the faces of the level before


@dataclass(frozen=True)
class OutputConfig:
    """Which files are written, and in which unit and orientation."""

    scale: float = 1.0  # All written lengths are multiplied by this. 1: the capture's own unit.
    up: Up = Up.AUTO
    obj: bool = False  # The file mesh.obj is written as well.
    usdz: bool = False  # The file model.usdz is written as well, for Apple's devices. It needs the package usd-core.
    draco: bool = False  # The file model_draco.glb is written as well: the textured model, compressed by Draco, with
    # maps as WebP. It needs the package DracoPy.
    # The textured model is decimated to this many faces, because its maps hold the detail. none: all faces.
    faces: int | None = 100_000
    # The side of the textured model's maps, in texels. none: it depends on the photographs' pixels
    # (expert.mesh.texture.texel).
    texture: int | None = None
    # Coarser levels of detail of the textured model: model_lod1.glb has a quarter of its faces and half of its texels
    # along a side, model_lod2.glb a quarter of those of model_lod1.glb, and so on.
    lods: int = 0
