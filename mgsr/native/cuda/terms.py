"""The loss terms on a GPU. Their sums and slopes stay on the GPU, and the host reads nothing."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from mgsr.native.cuda.launcher import Launcher
from mgsr.native.cuda.params import Double, Float, Int, Long, Pointer, addresses, pointer, pointers
from mgsr.native.structs import CompositedImage, ImageInBytes, WeightedDifference

THREADS, GRADIENT_FLOATS = 256, 1024
MOST_TERMS, MOST_IMAGES, MOST_PARTS = 24, 16, 4


class TargetParams(ctypes.Structure):
    """The struct TargetParams of kernels/terms/, as are the structs below."""

    _fields_ = (
        ("pixels", Long),
        *pointers("image", "mask", "off_edge", "background", "color", "alpha", "weights"),
    )


class CoveredParams(ctypes.Structure):
    _fields_ = (("pixels", Long), *pointers("alpha", "mask", "covered"))


class SilhouetteParams(ctypes.Structure):
    _fields_ = (
        ("pixels", Long),
        *pointers("alpha", "mask", "weights"),
        ("entropy", Int),
        *pointers("v_alpha", "sums"),
    )


class SquaredDifferenceParams(ctypes.Structure):
    _fields_ = (
        ("count", Long),
        *pointers("a", "b", "first", "second"),
        ("offset", Float),
        *pointers("differences", "sums"),
    )


class ProductParams(ctypes.Structure):
    _fields_ = (("pixels", Long), *pointers("weight", "color", "v_weight", "sums"))


class StepsParams(ctypes.Structure):
    _fields_ = (*((name, Int) for name in ("maps", "side", "channels")), *pointers("values", "v_values", "sums"))


class TermSums(ctypes.Structure):
    _fields_ = (
        ("sums", Pointer),
        ("blocks", Int),
        ("counted", Int),
        ("factor", Double),
        ("divisor", Pointer),
        ("weight", Float),
    )


class TotalsParams(ctypes.Structure):
    _fields_ = (("terms", TermSums * MOST_TERMS), *pointers("values", "scales"))


class GradientPart(ctypes.Structure):
    _fields_ = (
        ("slopes", Pointer),
        *((name, Int) for name in ("term", "channels")),
        ("factor", Float),
    )


class ImageGradient(ctypes.Structure):
    _fields_ = (
        ("out", Pointer),
        ("count", Long),
        *((name, Int) for name in ("channels", "parts", "end")),
        ("part", GradientPart * MOST_PARTS),
    )


class GradientsParams(ctypes.Structure):
    _fields_ = (("images", Int), *pointers("v_values", "scales"), ("image", ImageGradient * MOST_IMAGES))


@dataclass(slots=True)
class Sums:
    """The partial sums that a term's kernel writes on the GPU, partial [blocks,2] float64: a total and a count.

    The term is the sum of the totals, divided by `factor`; by the sum of the counts, if `counted`; and by `divisor` []
    float32, if it is given. It is 0 if the divisor is 0.
    """

    partial: Tensor
    factor: float
    counted: bool = False
    divisor: Tensor | None = None


@dataclass(slots=True)
class Part:
    """A term's part of an image's gradient: factor * slopes. term: the term's number."""

    slopes: Tensor
    term: int
    factor: float


@dataclass(slots=True)
class Image:
    """A tensor that gets a gradient: its shape, [H,W], [H,W,C] or any other, and the terms' parts of the gradient."""

    shape: torch.Size
    parts: list[Part] = field(default_factory=list)


class TermKernels:
    """The kernels of loss terms on one launcher."""

    def __init__(self, launcher: Launcher) -> None:
        self._launcher = launcher

    def composite(self, photograph: ImageInBytes, background: Tensor | None, out: CompositedImage) -> None:
        """Write a photograph on a background [3], None for black."""
        pixels = photograph.image.shape[0] * photograph.image.shape[1]
        arrays = (*photograph, background, *out)
        self._run("terms_target", pixels, TargetParams(pixels, *addresses(*arrays)))

    def covered(self, alpha: Tensor, mask: Tensor | None, covered: Tensor) -> None:
        """Write covered [H,W], given alpha [H,W] and mask [H,W] or None (see `mgsr.ops.pixels.covered`)."""
        params = CoveredParams(alpha.numel(), pointer(alpha), pointer(mask), pointer(covered))
        self._run("terms_covered", alpha.numel(), params)

    def silhouette(
        self, alpha: Tensor, mask: Tensor, weights: Tensor | None, entropy: bool, v_alpha: Tensor | None
    ) -> Sums:
        """Return the mean over all pixels of the difference of alpha [H,W] from a mask [H,W].

        weights [H,W]: factors of both; None means 1. entropy: whether to compute the cross entropy instead. Writes the
        gradient v_alpha [H,W] of the sum; None if not needed.
        """
        count, partial = alpha.numel(), _partial(alpha)
        inputs = (pointer(alpha), pointer(mask), pointer(weights), entropy)
        self._run("terms_silhouette", count, SilhouetteParams(count, *inputs, pointer(v_alpha), pointer(partial)))
        return Sums(partial, count)

    def squares(self, difference: WeightedDifference, by: float, divisor: Tensor | None, differences: Tensor) -> Sums:
        """Return the sum of the squares of a difference, divided by `by` and the divisor [].

        differences [...]: gets the difference itself.
        """
        count, partial = difference.a.numel(), _partial(difference.a)
        inputs = (*addresses(*difference[:4]), difference.offset)
        self._run(
            "terms_squares", count, SquaredDifferenceParams(count, *inputs, pointer(differences), pointer(partial))
        )
        return Sums(partial, by, divisor=divisor)

    def product(self, weight: Tensor, color: Tensor, v_weight: Tensor) -> Sums:
        """Return the mean of weight [H,W] times color [H,W,3], and write the gradient v_weight [H,W] of the sum."""
        count, partial = weight.numel(), _partial(weight)
        arrays = (weight, color, v_weight, partial)
        self._run("terms_product", count, ProductParams(count, *addresses(*arrays)))
        return Sums(partial, 3.0 * count)

    def steps(self, maps: Tensor, by: float, v_maps: Tensor | None) -> Sums:
        """Return the sum of the squared steps between neighbours in maps [M,S,S,C], divided by `by`.

        Writes the gradient v_maps [M,S,S,C] of the sum; None if not needed.
        """
        partial = _partial(maps)
        sizes = (maps.shape[0], maps.shape[1], maps.shape[3])
        params = StepsParams(*sizes, pointer(maps), pointer(v_maps), pointer(partial))
        self._run("terms_steps", maps.numel(), params)
        return Sums(partial, by)

    def totals(self, terms: Sequence[tuple[Sums, float]]) -> tuple[Tensor, Tensor]:
        """Return the terms' weighted values [T], and the factors [T] that convert their slopes to gradients."""
        values, scales = terms[0][0].partial.new_empty(2, len(terms), dtype=torch.float32).unbind()
        first_value, first_scale = values.data_ptr(), scales.data_ptr()
        for begin in range(0, len(terms), MOST_TERMS):
            some = terms[begin : begin + MOST_TERMS]
            params = TotalsParams(values=first_value + 4 * begin, scales=first_scale + 4 * begin)
            for entry, (sums, weight) in zip(params.terms, some, strict=False):
                entry.sums, entry.blocks, entry.counted = pointer(sums.partial), sums.partial.shape[0], sums.counted
                entry.factor, entry.divisor, entry.weight = sums.factor, pointer(sums.divisor), weight
            self._launcher.launch("terms", "terms_totals", len(some), THREADS, params)
        return values, scales

    def gradients(self, images: Sequence[Image], v_values: Tensor, scales: Tensor) -> list[Tensor]:
        """Return each image's gradient; v_values [T]: the gradients of the terms' values; scales [T]: from `totals`."""
        split = [(index, some) for index, image in enumerate(images) for some in _at_most(MOST_PARTS, image)]
        outs = [scales.new_empty(image.shape) for _, image in split]
        for begin in range(0, len(split), MOST_IMAGES):
            end, params = 0, GradientsParams(0, pointer(v_values), pointer(scales))
            for (_, image), out in zip(split[begin : begin + MOST_IMAGES], outs[begin:], strict=False):
                end += -(-out.numel() // GRADIENT_FLOATS)
                _describe(params.image[params.images], image, out, end)
                params.images += 1
            self._launcher.launch("terms", "terms_gradients", end, THREADS, params)
        gradients = outs[: len(images)]
        if len(split) > len(images):  # an image has more parts than a kernel takes at once
            gradients = [
                torch.stack([out for (i, _), out in zip(split, outs, strict=True) if i == index]).sum(dim=0)
                for index in range(len(images))
            ]
        return gradients

    def _run(self, kernel: str, count: int, params: ctypes.Structure) -> None:
        self._launcher.launch("terms", kernel, -(-count // THREADS), THREADS, params)


def _partial(like: Tensor) -> Tensor:
    """Allocate the sums [blocks,2] float64 of the blocks of a tensor [...]."""
    return like.new_empty(-(-like.numel() // THREADS), 2, dtype=torch.float64)


def _at_most(parts: int, image: Image) -> list[Image]:
    """Split an image into several copies with at most `parts` of its parts each."""
    if len(image.parts) <= parts:
        return [image]
    return [Image(image.shape, image.parts[begin : begin + parts]) for begin in range(0, len(image.parts), parts)]


def _describe(entry: ImageGradient, image: Image, out: Tensor, end: int) -> None:
    count, channels = image.shape.numel(), image.shape[2] if len(image.shape) == 3 else 1
    entry.out, entry.count, entry.channels = out.data_ptr(), count, channels
    entry.parts, entry.end = len(image.parts), end
    for index, part in enumerate(image.parts):
        own = channels if part.slopes.numel() == count else 1
        entry.part[index] = (pointer(part.slopes), part.term, own, part.factor)
