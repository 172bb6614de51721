"""The CUDA half of the 3D branch: the same calls as `mgsr.native._gaussians`."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import partial

from torch import Tensor

from mgsr.native.cuda.bands import add_bands, blend_bands
from mgsr.native.cuda.launcher import Launcher
from mgsr.native.cuda.params import Float, Int, Long, addresses, pointers
from mgsr.native.cuda.tiles import (
    BUCKET_THREADS,
    PAIR_FIELDS,
    PROJECTED,
    SPLAT_THREADS,
    TILE_PIXELS,
    Band,
    Blended,
    Projected,
    TileLists,
    Tiles,
    list_tiles,
    project,
    splat_blocks,
    sum_pairs,
)
from mgsr.native.cuda.view import CameraStruct, camera_struct
from mgsr.native.structs import (
    GaussianGradients,
    GaussianImageGradients,
    GaussianImages,
    GaussianSplats,
    GaussianView,
)

# Floats per pixel: the state at the beginning of a bucket, and the prepared inputs of the backward pass.
STATE_PLANES = {"single": 5, "dual": 10}
PIXEL_PLANES = {"single": 5, "dual": 10}
SPLAT_TENSORS = ("means", "quats", "scales", "opacities", "colors", "refl_opacities", "refl_colors", "weights")


class GaussianSplatsStruct(ctypes.Structure):
    """The struct GaussianSplats of kernels/gaussians/projection_cuda.h."""

    _fields_ = (
        ("count", Long),
        *pointers(*SPLAT_TENSORS),
        ("camera", CameraStruct),
        ("width", Int),
        ("height", Int),
        ("near", Float),
        ("low_pass", Float),
        ("compensate", Int),
    )


class GaussianProjectParams(ctypes.Structure):
    _fields_ = (("in", GaussianSplatsStruct), *PROJECTED)


class GaussianBlendParams(ctypes.Structure):
    _fields_ = (
        ("tiles", Tiles),
        *pointers("records", "background", "color", "alpha", "depth", "reflected", "weight"),
        *pointers("transmittance", "states", "reached"),
    )


class GaussianPixelParams(ctypes.Structure):
    _fields_ = (
        ("tiles", Tiles),
        *pointers("transmittance", "color", "depth", "reflected", "weight"),
        *pointers("v_color", "v_alpha", "v_depth", "v_reflected", "v_weight", "planes"),
    )


class GaussianBackwardParams(ctypes.Structure):
    _fields_ = (("tiles", Tiles), *pointers("records", "states", "reached", "planes", "pairs"))


class GaussianGradientParams(ctypes.Structure):
    _fields_ = (
        ("in", GaussianSplatsStruct),
        *pointers("records", "radii", "sums", "tile_counts"),
        *pointers(*(f"v_{name}" for name in SPLAT_TENSORS), "v_means2d"),
    )


@dataclass
class GaussianForwardState:
    """The results of forward that backward needs.

    blended: the blended band, if the image is one band; None once backward has taken it. Backward blends the bands of
    larger images again, one after the other.
    """

    projected: Projected
    radii: Tensor
    transmittance: Tensor
    bands: list[Band]
    blended: Blended | None = None

    def take_blended(self) -> Blended | None:
        """Return the kept blended band and release it, to save memory."""
        blended, self.blended = self.blended, None
        return blended


class GaussianKernels:
    """The kernels that render and differentiate 3D Gaussians on one launcher.

    keep: whether backward will be called for the frame.
    """

    def __init__(self, launcher: Launcher, keep: bool) -> None:
        self._launcher, self._keep = launcher, keep

    def forward(
        self, splats: GaussianSplats, view: GaussianView, images: GaussianImages, radii: Tensor
    ) -> GaussianForwardState:
        """Render into the images and radii [N], and return the state for `backward`.

        Raises GpuError if the GPU's memory is too small.
        """
        projected = project(self._launcher, "gaussians", GaussianProjectParams, splats_struct(splats, view), radii)
        transmittance = radii.new_empty(projected.height, projected.width)
        frame = GaussianForwardState(projected, radii, transmittance, [projected.whole])
        blend = partial(self._blend, frame, splats.background, images)
        frame.bands, frame.blended = blend_bands(self._launcher, projected, blend, self._keep)
        return frame

    def backward(
        self,
        frame: GaussianForwardState,
        splats: GaussianSplats,
        view: GaussianView,
        images: GaussianImages,
        v_images: GaussianImageGradients,
        v_splats: GaussianGradients,
    ) -> None:
        """Write the splats' gradients, given those of the images; `view` must be the frame's.

        Raises GpuError if the GPU's memory is too small.
        """
        assert self._keep, "the render was made without a backward pass"

        def walk_back(band: Band) -> Tensor:
            """Return the gradients [N,16] of a band's splats."""
            blended = frame.take_blended() or self._blend(frame, splats.background, images, band, keep=True)
            return self._walk_back(frame, blended, images, v_images)

        sums = add_bands(self._launcher, frame.projected, frame.bands, walk_back)
        arrays = (frame.projected.records, frame.radii, sums, frame.projected.whole.tile_counts, *v_splats)
        gradients = GaussianGradientParams(frame.projected.splats, *addresses(*arrays))
        blocks = splat_blocks(splats.means.shape[0])
        self._launcher.launch("gaussians", "gaussians_gradients", blocks, SPLAT_THREADS, gradients)

    def _blend(
        self, frame: GaussianForwardState, background: Tensor, images: GaussianImages, band: Band, keep: bool
    ) -> Blended:
        """Render a band's pixels into the images."""
        lists, kind = list_tiles(self._launcher, frame.projected, band), _kind(images)
        reached, states = lists.ranges.new_empty(lists.tiles), None
        if keep:
            states = background.new_empty(lists.most_buckets, STATE_PLANES[kind], TILE_PIXELS)
        arrays = (frame.projected.records, background, *images, frame.transmittance, states, reached)
        params = GaussianBlendParams(lists.struct, *addresses(*arrays))
        self._launcher.launch("gaussians", f"gaussians_blend_{kind}", lists.tiles, TILE_PIXELS, params)
        return Blended(lists, states, reached)

    def _walk_back(
        self, frame: GaussianForwardState, blended: Blended, images: GaussianImages, v_images: GaussianImageGradients
    ) -> Tensor:
        """Return the gradients [N,16] of each splat from a band's pixels."""
        lists, kind = blended.lists, _kind(images)
        planes = self._prepare_pixels(kind, frame, lists, images, v_images)
        pairs = planes.new_empty(lists.pairs, PAIR_FIELDS)
        arrays = (frame.projected.records, blended.states, blended.reached, planes, pairs)
        params = GaussianBackwardParams(lists.struct, *addresses(*arrays))
        self._launcher.launch("gaussians", f"gaussians_backward_{kind}", lists.bucket_blocks, BUCKET_THREADS, params)
        return sum_pairs(self._launcher, lists, pairs)

    def _prepare_pixels(
        self,
        kind: str,
        frame: GaussianForwardState,
        lists: TileLists,
        images: GaussianImages,
        v_images: GaussianImageGradients,
    ) -> Tensor:
        planes = images.color.new_empty(lists.tiles, PIXEL_PLANES[kind], TILE_PIXELS)
        forward = (frame.transmittance, images.color, images.depth, images.reflected, images.weight)
        params = GaussianPixelParams(lists.struct, *addresses(*forward, *v_images, planes))
        self._launcher.launch("gaussians", f"gaussians_pixels_{kind}", lists.tiles, TILE_PIXELS, params)
        return planes


def _kind(images: GaussianImages) -> str:
    return "single" if images.reflected is None else "dual"


def splats_struct(splats: GaussianSplats, view: GaussianView) -> GaussianSplatsStruct:
    """Return the struct of the splats, which must outlive the launch, and the view, for the kernels' parameters."""
    camera = view.camera
    arrays = addresses(
        *(splats.means, splats.quats, splats.scales, splats.opacities, splats.colors),
        *(splats.refl_opacities, splats.refl_colors, splats.weights),
    )
    lens = (camera_struct(camera), camera.width, camera.height)
    return GaussianSplatsStruct(splats.means.shape[0], *arrays, *lens, view.near, view.low_pass, view.compensate)
