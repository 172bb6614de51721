"""Local features of photographs, and which photographs show the same things."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.cluster.vq import kmeans2

from mgsr.config.expert import FeatureOptions
from mgsr.data.images import composite_on_white, srgb_to_linear
from mgsr.data.scene import View
from mgsr.parallel import map_ahead


@dataclass(frozen=True)
class Features:
    """The features of one photograph.

    pixels [N,2] float64: the places in the view's own image.
    descriptors [N,128] float32: RootSIFT (Arandjelovic and Zisserman 2012), of unit length.
    scale: the size of a pixel of the image in which the features were found, in pixels of the view.
    light [N] float32: the logarithm of the linear light around each feature, NaN where it is clipped or black.
    """

    pixels: np.ndarray
    descriptors: np.ndarray
    scale: float
    light: np.ndarray

    def __len__(self) -> int:
        return len(self.pixels)


def find_features(views: Sequence[View], options: FeatureOptions = FeatureOptions()) -> list[Features]:
    """Find the features of each view on its valid pixels, and on the object alone if the view has a mask."""
    return list(map_ahead(lambda view: _features(view, options), views, None))


def _features(view: View, options: FeatureOptions) -> Features:
    import cv2  # imported here, because training needs no OpenCV

    pixels = view.image if view.alpha is None else composite_on_white(view.image, view.alpha)
    grey: np.ndarray = cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)
    shown: np.ndarray = np.ones(grey.shape, np.uint8) if view.alpha is None else (view.alpha > 127).astype(np.uint8)
    if view.valid_mask is not None:
        shown &= view.valid_mask.astype(np.uint8)
    scale = max(1.0, max(grey.shape) / options.side)
    if scale > 1:
        size = (round(grey.shape[1] / scale), round(grey.shape[0] / scale))
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
        shown = cv2.resize(shown, size, interpolation=cv2.INTER_NEAREST)
    inner = cv2.erode(shown, np.ones((2 * options.edge + 1,) * 2, np.uint8), borderValue=1)
    found, descriptors = cv2.SIFT_create(options.count).detectAndCompute(grey, inner)  # type: ignore[attr-defined]
    if descriptors is None:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32), scale, np.zeros(0, np.float32))
    places = np.array([point.pt for point in found], np.float64) + 0.5
    # SIFT may return one feature too many if two have the same strength.
    order = np.argsort([-point.response for point in found], kind="stable")[: options.count]
    across = np.array([view.camera.width / grey.shape[1], view.camera.height / grey.shape[0]])
    roots = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6))
    light = _light(pixels, places[order], grey.shape, options)
    return Features(places[order] * across, roots[order].astype(np.float32), scale, light)


def _light(image: np.ndarray, places: np.ndarray, size: tuple[int, ...], options: FeatureOptions) -> np.ndarray:
    """Return the logarithm of the mean linear light [N] around places [N,2]; NaN where it is clipped or black.

    image [H,W,3] uint8: the photograph. size: the rows and columns of the image that the places belong to.
    """
    import cv2  # imported here, because training needs no OpenCV

    table = srgb_to_linear(np.arange(256) / 255).astype(np.float32)
    lost = ((image >= options.clipped) | (image <= options.black)).any(axis=2).astype(np.float32)
    both = cv2.resize(np.dstack([table[image].mean(axis=2), lost]), size[1::-1], interpolation=cv2.INTER_AREA)
    both = cv2.GaussianBlur(both, (0, 0), options.around)
    columns, rows = np.minimum(places.astype(np.int64), np.array(size[1::-1]) - 1).T
    light, unknown = both[rows, columns].T
    return np.where(unknown < options.lost, np.log(np.maximum(light, table[1])), np.nan).astype(np.float32)


def match(one: Features, other: Features, ratio: float = FeatureOptions().ratio) -> np.ndarray:
    """Return the matches of two photographs: the indices [M,2] of features that are each other's only near ones.

    ratio: the largest ratio between the distances of the best and the second best match.
    """
    if min(len(one), len(other)) < 2:
        return np.zeros((0, 2), np.int64)
    alike = one.descriptors @ other.descriptors.T
    best = alike.argmax(axis=1)
    rows = np.arange(len(one))
    mutual = alike.argmax(axis=0)[best] == rows
    top = alike[rows, best].copy()
    alike[rows, best] = -1
    # The squared distance of vectors of unit length is 2 - 2 cos.
    clear = 1 - top < ratio**2 * (1 - alike.max(axis=1))
    kept = mutual & clear
    return np.stack([rows[kept], best[kept]], axis=1)


def similarity(features: Sequence[Features], options: FeatureOptions = FeatureOptions(), seed: int = 0) -> np.ndarray:
    """Return the similarity [V,V], from -1 to 1, of each two photographs, without using the cameras.

    It is the cosine between their vectors of locally aggregated descriptors (VLAD, Jegou and others 2010). The small
    vocabulary comes from the photographs' own features.
    """
    every = np.concatenate([one.descriptors for one in features])
    if len(every) < 2 * options.words:
        return np.zeros((len(features), len(features)))
    rng = np.random.default_rng(seed)
    sample = every[rng.permutation(len(every))[: options.sample]]
    words, _ = kmeans2(sample, options.words, iter=10, minit="points", rng=rng, missing="warn")
    vectors = np.stack([_aggregated(one.descriptors, words) for one in features])
    return np.asarray(vectors @ vectors.T)


def _aggregated(descriptors: np.ndarray, words: np.ndarray) -> np.ndarray:
    """Return the vector [W*128] of a photograph's descriptors [N,128]: their offsets from the nearest words [W,128]."""
    sums = np.zeros_like(words)
    if len(descriptors):
        nearest = (2 * descriptors @ words.T - (words * words).sum(axis=1)).argmax(axis=1)
        np.add.at(sums, nearest, descriptors - words[nearest])
        sums /= np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-9)
    return np.asarray(sums.ravel() / max(float(np.linalg.norm(sums)), 1e-9))
