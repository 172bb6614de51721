"""The images that are derived from a view: values of the sRGB standard, and pixels counted by hand."""

from __future__ import annotations

import gc
import weakref
from dataclasses import fields

import numpy as np
import pytest
from scipy import ndimage

from mgsr.data.camera import Camera
from mgsr.data.photograph import Photograph
from mgsr.data.scene import View

# Grey bytes and their linear light by IEC 61966-2-1, to four digits; 118 is the 18% grey of photography.
LINEAR = {0: 0.0, 10: 0.0030, 64: 0.0513, 118: 0.1812, 188: 0.5029, 255: 1.0}


def photograph(image: np.ndarray, alpha: np.ndarray | None = None, valid_mask: np.ndarray | None = None) -> Photograph:
    height, width = image.shape[:2]
    return Photograph(View("v", Camera(np.eye(3), np.eye(4), width, height), image, alpha, valid_mask))


def test_brightness_is_the_channels_mean_in_linear_light() -> None:
    greys = np.array(list(LINEAR), np.uint8)
    found = photograph(np.repeat(greys[None, :, None], 3, axis=2)).brightness
    assert found.dtype == np.float32
    np.testing.assert_allclose(found[0], list(LINEAR.values()), atol=5e-5)
    mixed = photograph(np.array([[[255, 118, 0]]], np.uint8)).brightness
    np.testing.assert_allclose(mixed, [[(1 + 0.1812) / 3]], atol=5e-5)


def test_invalid_pixels_are_dark_and_nothing_is_read_beside_them() -> None:
    image = np.full((9, 9, 3), 118, np.uint8)
    valid = np.ones((9, 9), bool)
    valid[4, 4] = False
    found = photograph(image, valid_mask=valid)
    assert found.brightness[4, 4] == 0 and (found.brightness[valid] > 0.18).all()
    np.testing.assert_array_equal(found.opaque, valid)
    expected = ndimage.binary_erosion(valid, np.ones((3, 3)))
    assert 0 < expected.sum() < valid.sum() - 8
    np.testing.assert_array_equal(found.interior, expected)
    np.testing.assert_array_equal(found.usable, expected)


def test_pixels_that_are_clipped_or_mixed_are_not_used() -> None:
    image = np.full((1, 5, 3), 118, np.uint8)
    image[0, 1] = (118, 250, 118)  # of 255: above 98%
    image[0, 2] = (118, 249, 118)
    alpha = np.array([[255, 255, 248, 247, 0]], np.uint8)  # of 255: 97% is 247.35
    found = photograph(image, alpha)
    np.testing.assert_array_equal(found.usable, [[True, False, True, False, False]])
    assert found.interior is None


@pytest.mark.parametrize("name", ["brightness", "opaque", "interior"])
def test_images_are_made_once_and_go_with_the_photograph(name: str) -> None:
    """Check that nothing is left on the view, which a scene keeps for the whole run."""
    given = photograph(np.full((6, 6, 3), 118, np.uint8), valid_mask=np.ones((6, 6), bool))
    view, image = given.view, weakref.ref(getattr(given, name))
    gc.collect()
    assert image() is getattr(given, name)
    del given
    gc.collect()
    assert image() is None
    assert set(vars(view)) == {field.name for field in fields(View)}
