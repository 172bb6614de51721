"""The CUDA half of the 3D branch: the same calls as `mgsr.native._gaussians`."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import partial
from typing import Any

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
from mgsr.native.cuda.view import Camera, camera_struct

# Floats kept of each pixel at the begin of a bucket, and made ready of each pixel for the backward pass.
STATE_PLANES = {"single": 5, "dual": 10}
PIXEL_PLANES = {"single": 5, "dual": 10}
SPLAT_TENSORS = ("means", "quats", "scales", "opacities", "colors", "refl_opacities", "refl_colors", "weights")


class Splats(ctypes.Structure):
    """The struct GaussianSplats of kernels/gaussians/projection_cuda.h."""

    _fields_ = (
        ("count", Long),
        *pointers(*SPLAT_TENSORS),
        ("camera", Camera),
        ("width", Int),
        ("height", Int),
        ("near", Float),
        ("low_pass", Float),
        ("compensate", Int),
    )


class ProjectParams(ctypes.Structure):
    _fields_ = (("in", Splats), *PROJECTED)


class BlendParams(ctypes.Structure):
    _fields_ = (
        ("tiles", Tiles),
        *pointers("records", "background", "color", "alpha", "depth", "reflected", "weight"),
        *pointers("transmittance", "states", "reached"),
    )


class PixelParams(ctypes.Structure):
    _fields_ = (
        ("tiles", Tiles),
        *pointers("transmittance", "color", "depth", "reflected", "weight"),
        *pointers("v_color", "v_alpha", "v_depth", "v_reflected", "v_weight", "planes"),
    )


class BackwardParams(ctypes.Structure):
    _fields_ = (("tiles", Tiles), *pointers("records", "states", "reached", "planes", "pairs"))


class GradientParams(ctypes.Structure):
    _fields_ = (
        ("in", Splats),
        *pointers("records", "radii", "sums", "tile_counts"),
        *pointers(*(f"v_{name}" for name in SPLAT_TENSORS), "v_means2d"),
    )


@dataclass
class Frame:
    """What backward needs kept from forward.

    blended: of the one band that most images are, until backward takes it; bands of an image too large for that are
    blended again in backward, one after the other.
    """

    projected: Projected
    radii: Tensor
    transmittance: Tensor
    bands: list[Band]
    blended: Blended | None = None

    def take_blended(self) -> Blended | None:
        """Return the blended band that is kept, and keep it no longer: memory may be short."""
        blended, self.blended = self.blended, None
        return blended


class GaussianKernels:
    """The kernels that render and differentiate 3D Gaussians on one launcher.

    Arguments as in `mgsr.native._gaussians`; keep: whether backward will be called for the frame.
    """

    def __init__(self, launcher: Launcher, keep: bool) -> None:
        self._launcher, self._keep = launcher, keep

    def forward(self, *arguments: Any) -> Frame:
        """Render into the images and radii given, and return what `backward` takes.

        Raises GpuError where the card's memory is too small.
        """
        splats, background, view, images, radii = (
            arguments[:8],
            arguments[8],
            arguments[9:16],
            arguments[16:21],
            arguments[21],
        )
        projected = project(self._launcher, "gaussians", ProjectParams, splats_struct(splats, view), radii)
        transmittance = background.new_empty(projected.height, projected.width)
        frame = Frame(projected, radii, transmittance, [projected.whole])
        blend = partial(self._blend, _kind(splats), frame, background, images)
        frame.bands, frame.blended = blend_bands(self._launcher, projected, blend, self._keep)
        return frame

    def backward(self, frame: Frame, *arguments: Any) -> None:
        """Write the splats' gradients from those of the images.

        Raises GpuError where the card's memory is too small.
        """
        assert self._keep, "the render was made without a backward pass"
        splats, background = arguments[:8], arguments[8]
        images, v_images, v_splats = arguments[16:21], arguments[21:26], arguments[26:]
        kind = _kind(splats)

        def walk_back(band: Band) -> Tensor:
            """Return the gradients [N,16] of a band's splats."""
            blended = frame.take_blended() or self._blend(kind, frame, background, images, band, keep=True)
            return self._walk_back(kind, frame, blended, images, v_images)

        sums = add_bands(self._launcher, frame.projected, frame.bands, walk_back)
        arrays = (frame.projected.records, frame.radii, sums, frame.projected.whole.tile_counts, *v_splats)
        gradients = GradientParams(frame.projected.splats, *addresses(*arrays))
        blocks = splat_blocks(splats[0].shape[0])
        self._launcher.launch("gaussians", "gaussians_gradients", blocks, SPLAT_THREADS, gradients)

    def _blend(self, kind: str, frame: Frame, background: Tensor, images: Any, band: Band, keep: bool) -> Blended:
        """Draw a band's pixels into the images."""
        lists = list_tiles(self._launcher, frame.projected, band)
        reached, states = lists.ranges.new_empty(lists.tiles), None
        if keep:
            states = background.new_empty(lists.most_buckets, STATE_PLANES[kind], TILE_PIXELS)
        arrays = (frame.projected.records, background, *images, frame.transmittance, states, reached)
        params = BlendParams(lists.struct, *addresses(*arrays))
        self._launcher.launch("gaussians", f"gaussians_blend_{kind}", lists.tiles, TILE_PIXELS, params)
        return Blended(lists, states, reached)

    def _walk_back(self, kind: str, frame: Frame, blended: Blended, images: Any, v_images: Any) -> Tensor:
        """Return the gradients [N,16] of each splat from a band's pixels."""
        lists = blended.lists
        planes = self._prepare_pixels(kind, frame, lists, images, v_images)
        pairs = planes.new_empty(lists.pairs, PAIR_FIELDS)
        arrays = (frame.projected.records, blended.states, blended.reached, planes, pairs)
        params = BackwardParams(lists.struct, *addresses(*arrays))
        self._launcher.launch("gaussians", f"gaussians_backward_{kind}", lists.bucket_blocks, BUCKET_THREADS, params)
        return sum_pairs(self._launcher, lists, pairs)

    def _prepare_pixels(self, kind: str, frame: Frame, lists: TileLists, images: Any, v_images: Any) -> Tensor:
        color, _, depth, reflected, weight = images
        planes: Tensor = color.new_empty(lists.tiles, PIXEL_PLANES[kind], TILE_PIXELS)
        arrays = (frame.transmittance, color, depth, reflected, weight, *v_images, planes)
        params = PixelParams(lists.struct, *addresses(*arrays))
        self._launcher.launch("gaussians", f"gaussians_pixels_{kind}", lists.tiles, TILE_PIXELS, params)
        return planes


def _kind(splats: Any) -> str:
    return "single" if splats[5] is None else "dual"


def splats_struct(splats: Any, view: Any) -> Splats:
    """Return the struct of the splats and the view, for the kernels' parameters.

    splats: tensors as SPLAT_TENSORS, None for those that are not there, which must outlive the launch; view: as
    `mgsr.native._gaussians` takes it.
    """
    K, cam_from_world, width, height, near, low_pass, compensate = view
    camera = camera_struct(K, cam_from_world, width, height)
    arrays = addresses(*splats)
    return Splats(splats[0].shape[0], *arrays, camera, width, height, near, low_pass, compensate)
