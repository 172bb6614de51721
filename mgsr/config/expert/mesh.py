"""Options of the mesh's extraction, its colours and its texture (`mgsr.mesh`).

Pixels are those of the photographs on the surface; a footprint is what a pixel of the rendered views covers there.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from mgsr.config.expert.geometry import ChartOptions
from mgsr.config.expert.mesh_steps import MeshStepOptions
from mgsr.config.expert.shading import GlossOptions, StaticLightOptions
from mgsr.config.options import Count, NotNegative, Options, Positive, Range, Share, WholeNumber


@dataclass(frozen=True)
class SurfaceChoiceOptions(Options):
    """The choice between the trained surface and the first one."""

    max_start_residual: NotNegative = 0.98  # environment residual of the first surface, over the trained one's, up to
    # which the first surface is better
    tears: WholeNumber = 40  # boundary loops plus twice the handles, in excess of the first surface's, above which the
    # trained surface counts as torn; torn ones have hundreds
    min_gain: NotNegative = 0.02  # photo-consistency by which the first surface must exceed the trained one


@dataclass(frozen=True)
class ColorOptions(Options):
    """The colours of vertices and texels, blended from the rendered views."""

    deviation: Positive = 0.1  # sRGB 0..1; a colour this far from the mean counts half
    rounds: WholeNumber = 2  # of reweighting
    tolerance: Positive = 3.0  # footprints; the depth tolerance if the views' consistency is not checked
    grazing: Share = 0.05  # cosine between normal and view direction at which a view stops showing a point
    occlusion_edge: Positive = 10.0  # footprints by which the depths around a pixel of a texture may differ; more is an
    # occlusion edge
    back_projections: WholeNumber = 2  # rounds of iterative back-projection, which sharpens textures
    prior_weight: Positive = 1.0  # weight of no change in back-projection, because few views tell little; the weight of
    # a head-on view is 1
    min_texels: NotNegative = 0.5  # mean number of texels in a pixel of a view; with fewer, the pixel sharpens none


@dataclass(frozen=True)
class UnwrapOptions(Options):
    """The unwrapping of the surface into a texture atlas."""

    padding: WholeNumber = 4  # texels between two charts, so that neither bilinear sampling nor mipmaps mix them
    min_chart: Positive = 4.0  # texels along a side of the smallest chart
    max_side: Count = 8192  # texels along a side of the atlas; larger pictures are too large for many viewers
    filled: Annotated[float, Range(0, 1, open=True)] = 0.6  # usual share of an atlas that charts fill
    flat: Positive = 1e-6  # area of a face in its chart, in squared texels and in squared lengths of its longest edge,
    # up to which it counts as flat; xatlas leaves out faces of less than 1.2e-7 squared texels
    charts: ChartOptions = field(default_factory=ChartOptions)


@dataclass(frozen=True)
class TextureOptions(Options):
    """The textured model: what is baked from the full surface into its pictures."""

    texel: Positive = 0.67  # pixels of the photographs; size of a texel of the finest level
    edge: Positive = 2.0  # pixels; edge length of the mesh on which occlusion and shading are computed
    max_faces: Count = 50_000  # most faces of the mesh with that edge length
    same_side: Share = 0.2  # cosine between the normals of two surfaces below which they are different sides of a sheet
    min_z: Positive = 0.05  # least z of a baked normal; a renderer shows black where it looks away from the surface
    brightest: Share = 0.9  # albedo that no surface exceeds; less light than that is not believed
    brighter: Share = 0.01  # share of the vertices that may exceed it
    level_faces: Annotated[float, Range(0, 1, open=True)] = 0.25  # faces of a level of detail, over the level before
    level_texels: Annotated[float, Range(0, 1, open=True)] = (
        0.5  # texels along a side of a level, over the level before
    )
    min_level_faces: Count = 500  # faces below which there is no coarser level
    unwrap: UnwrapOptions = field(default_factory=UnwrapOptions)
    gloss: GlossOptions = field(default_factory=GlossOptions)
    static_light: StaticLightOptions = field(default_factory=StaticLightOptions)


@dataclass(frozen=True)
class MeshOptions(Options):
    """The mesh's extraction and finishing."""

    mask_side: Annotated[int, Range(16)] = 800  # pixels; longer side of the reduced masks, whose contours keep
    # sub-pixel accuracy
    poisson_margin: Annotated[float, Range(1)] = 1.1  # side of the octree's cube, relative to the points' bounding box
    outliers: Annotated[float, Range(0, 50)] = 0.1  # percent of the rendered points at each end of an axis that do not
    # count for the surface's bounding box
    confirm_reach: Positive = 2.0  # times the tolerance; the distance from a view's surface up to which the view
    # confirms a point, wide enough for the noise of depths
    supporting_views: Count = 3  # views that must see a point of the first surface, so that the surface there is kept
    choice: SurfaceChoiceOptions = field(default_factory=SurfaceChoiceOptions)
    colors: ColorOptions = field(default_factory=ColorOptions)
    texture: TextureOptions = field(default_factory=TextureOptions)
    steps: MeshStepOptions = field(default_factory=MeshStepOptions)
