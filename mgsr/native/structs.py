"""The structs that kernels take, the same on the CPU and on a GPU.

Arrays and numbers that belong together reach a kernel as one named tuple of this file, and no function of the bindings
takes more than six arguments. Callers fill the fields by name. A type checker finds a field that is missing or of
another type, and a struct in place of another. The C++ bindings read the fields by name
(`mgsr/native/bindings/fields.h`). The kernels of `mgsr.native.cuda` take the same tuples. The stubs beside this file
declare the functions.

Arrays are contiguous, and on the CPU or on the kernels' GPU. The bindings convert none of them, since the kernel would
write its output to a copy. An array of another dtype or layout raises TypeError, and one of another size raises
ValueError or, where the size is fixed, TypeError.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from torch import Tensor


class PinholeCamera(Protocol):
    """A pinhole camera, such as `mgsr.data.camera.Camera`, with the four attributes that kernels read.

    K [3,3]: pixels, without skew. cam_from_world [4,4]: rigid, OpenCV axes. Kernels read numbers of any type.
    """

    @property
    def K(self) -> np.ndarray:  # noqa: N802
        """Return the intrinsics [3,3]."""

    @property
    def cam_from_world(self) -> np.ndarray:
        """Return the pose [4,4]."""

    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...


class SurfelSplats(NamedTuple):
    """Surfels and the background behind them.

    means [N,3] world; quats [N,4] wxyz; scales [N,2] world units; opacities [N]; colors [N,3]; background [3].
    """

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor
    colors: Tensor
    background: Tensor


class SurfelView(NamedTuple):
    """The camera of a rendering of surfels, and the options of `mgsr.ops.surfels.SurfelOptions`."""

    camera: PinholeCamera
    near: float
    far: float
    low_pass: float


class SurfelImages(NamedTuple):
    """The images of `mgsr.ops.surfels.SurfelRaster`: color and normal [H,W,3], the others [H,W].

    distortion: None if it is not requested.
    """

    color: Tensor
    alpha: Tensor
    depth: Tensor
    median_depth: Tensor
    normal: Tensor
    distortion: Tensor | None


class SurfelImageGradients(NamedTuple):
    """The gradients of `SurfelImages`, each of its image's shape; None is zero."""

    color: Tensor | None
    alpha: Tensor | None
    depth: Tensor | None
    median_depth: Tensor | None
    normal: Tensor | None
    distortion: Tensor | None


class SurfelGradients(NamedTuple):
    """The gradients of `SurfelSplats`, each of its tensor's shape, and means2d [N,2]: of shifts in the image, pixels.

    The CPU's kernel writes only those of visible splats, so that the caller zeroes them; a GPU's kernel writes all.
    """

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor
    colors: Tensor
    means2d: Tensor


class GaussianSplats(NamedTuple):
    """3D Gaussians and the background behind them.

    means [N,3]: in the world frame.
    quats [N,4]: wxyz.
    scales [N,3]: world units.
    opacities [N], colors [N,3].
    refl_opacities [N], refl_colors [N,3], weights [N]: the reflected part, all None for a single opacity.
    background [3].
    """

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor
    colors: Tensor
    refl_opacities: Tensor | None
    refl_colors: Tensor | None
    weights: Tensor | None
    background: Tensor


class GaussianView(NamedTuple):
    """The camera of a rendering of 3D Gaussians, and the options of `mgsr.ops.gaussians.GaussianOptions`."""

    camera: PinholeCamera
    near: float
    low_pass: float
    compensate: bool


class GaussianImages(NamedTuple):
    """The images of `mgsr.ops.gaussians.GaussianRaster`: color and reflected [H,W,3], the others [H,W].

    depth: None if it is not requested. reflected, weight: None for a single opacity.
    """

    color: Tensor
    alpha: Tensor
    depth: Tensor | None
    reflected: Tensor | None
    weight: Tensor | None


class GaussianImageGradients(NamedTuple):
    """The gradients of `GaussianImages`, each of its image's shape; None is zero."""

    color: Tensor | None
    alpha: Tensor | None
    depth: Tensor | None
    reflected: Tensor | None
    weight: Tensor | None


class GaussianGradients(NamedTuple):
    """The gradients of `GaussianSplats`, each of its tensor's shape, and means2d [N,2]: of the centres in pixels.

    The CPU's kernel writes only those of visible splats, so that the caller zeroes them; a GPU's kernel writes all.
    """

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor
    colors: Tensor
    refl_opacities: Tensor | None
    refl_colors: Tensor | None
    weights: Tensor | None
    means2d: Tensor


class Harmonics(NamedTuple):
    """Splats coloured by spherical harmonics.

    coeffs [N,K,3]; means [N,3] world; center [3]: the camera's, world; degree: the highest band used, 0..3.
    """

    coeffs: Tensor
    means: Tensor
    center: Tensor
    degree: int


class EnvironmentMapLookup(NamedTuple):
    """A look-up of environment maps along the rays that normals reflect.

    maps [2,S,S,3].
    normals [H,W,3]: one in each pixel, in the world frame, of any length; None with samples.
    samples [P,N,N,3]: normals in N rows and columns of each pixel, as long as their weights; None with normals.
    pixels [P] int64: row * width + column of the pixels to compute, None for all.
    camera: the image's camera.
    """

    maps: Tensor
    normals: Tensor | None
    samples: Tensor | None
    pixels: Tensor | None
    camera: PinholeCamera


class ImagePair(NamedTuple):
    """An image and the target of its loss, with the options of `mgsr.ops.image_loss.image_loss_term`.

    image, target [H,W,3].
    mask [H,W]: or None.
    l1_weight: 0..1.
    clip: whether image values above 1 count as 1.
    """

    image: Tensor
    target: Tensor
    mask: Tensor | None
    l1_weight: float
    clip: bool


class DepthSurface(NamedTuple):
    """The surface of a depth map.

    depth [H,W]: camera z; alpha [H,W]: the length of its normals, None for 1; camera: of the image.
    """

    depth: Tensor
    alpha: Tensor | None
    camera: PinholeCamera


class AdamParameter(NamedTuple):
    """A parameter with its moments, values, first and second [rows,columns], which an update changes in place.

    column_scales [columns]: multiplies the learning rate; None for 1.
    """

    values: Tensor
    first: Tensor
    second: Tensor
    column_scales: Tensor | None


class ImageInBytes(NamedTuple):
    """A photograph as bytes.

    image [H,W,3] uint8: straight colours. mask [H,W] uint8, or None. off_edge [H,W] bool: which pixels count, or None.
    """

    image: Tensor
    mask: Tensor | None
    off_edge: Tensor | None


class CompositedImage(NamedTuple):
    """A photograph on a background: color [H,W,3]; alpha and weights [H,W], 0..1, each None if not needed."""

    color: Tensor
    alpha: Tensor | None
    weights: Tensor | None


class WeightedDifference(NamedTuple):
    """The difference (a - b) * first * second - offset of arrays [...]; None is 0 for b, and 1 for the weights."""

    a: Tensor
    b: Tensor | None
    first: Tensor | None
    second: Tensor | None
    offset: float


class UnlitGradients(NamedTuple):
    """The gradients of an image before it is lit: v_unlit [H,W,3] and v_alpha [H,W]."""

    v_unlit: Tensor
    v_alpha: Tensor


class SplatStatistics(NamedTuple):
    """The statistics of N splats for densification, which an image changes in place.

    gradient_sum [N]: the sum of the lengths of the gradients; seen [N]: the images that show the splat.
    """

    gradient_sum: Tensor
    seen: Tensor


class StereoViews(NamedTuple):
    """A photograph to match with its neighbours.

    images: of each view, [h,w,4] float32, sRGB and the share of the pixel that shows the object, 0..1. cameras [V,16]
    float32: see `mgsr.data.camera.pinhole_row`. view: the photograph's number; neighbours: those of the others.
    range: the least and the largest camera z.
    """

    images: Sequence[np.ndarray]
    cameras: np.ndarray
    view: int
    neighbours: Sequence[int]
    range: tuple[float, float]


class StereoPlanes(NamedTuple):
    """A plane at each pixel: depth [h,w] float32, camera z, and unit normal [h,w,3] float32, camera axes."""

    depth: np.ndarray
    normal: np.ndarray


class StereoSettings(NamedTuple):
    """Settings of the stereo matching.

    radius: samples of a patch on each side of its centre, 0..4. spacing: pixels between samples. noise: standard
    deviation of the image noise, sRGB 0..1. alike, reach: the colour difference, sRGB 0..1, and the distance, in
    pixels, from the centre at which a sample weighs 0.6. best: the number of best neighbours whose mean correlation is
    the score. cover: the least share of a patch that must show the object in a neighbour. prior: the loss in score of a
    depth that is prior_reach pixels off the start. search: the variation of depths in the first round, in pixels.
    rounds: the number of rounds of the search.
    """

    radius: int
    spacing: float
    noise: float
    alike: float
    reach: float
    best: int
    cover: float
    prior: float
    prior_reach: float
    search: float
    rounds: int


class VotingMaps(NamedTuple):
    """Depth maps that vote on the distances of points.

    cameras [V,16] float64: see `mgsr.data.camera.pinhole_row`. depths: of each view, [h,w] float32, camera z; weights:
    of its pixels, [h,w] float32.
    """

    cameras: np.ndarray
    depths: Sequence[np.ndarray]
    weights: Sequence[np.ndarray]


class MirroredObservations(NamedTuple):
    """P points' observations in K views, all float32.

    view_directions [P,K,3]: unit, from the point to the camera. brightness [P,K]: linear light. weights [P,K]: 0 where
    a point is not visible.
    """

    view_directions: np.ndarray
    brightness: np.ndarray
    weights: np.ndarray
