"""Shapes by letters: what fits, what is named, and what may be left out."""

from __future__ import annotations

import pytest
import torch

from mgsr.checks import check_tensors
from mgsr.errors import TensorError

PLANE, IMAGE = torch.zeros(4, 5), torch.zeros(4, 5, 3)


def test_letters_take_sizes() -> None:
    assert check_tensors(image=(IMAGE, "H W 3"), plane=(PLANE, "H W")) == {"H": 4, "W": 5}
    assert check_tensors({"H": 4}, plane=(PLANE, "H W")) == {"H": 4, "W": 5}
    assert check_tensors(scalar=(torch.zeros(()), "")) == {}


def test_sizes_that_are_given_are_not_changed() -> None:
    sizes = {"H": 4}
    check_tensors(sizes, plane=(PLANE, "H W"))
    assert sizes == {"H": 4}


@pytest.mark.parametrize(
    ("specs", "message"),
    [
        ({"image": (IMAGE, "H W 3"), "plane": (PLANE[:3], "H W")}, r"plane: expected \[H=4, W=5\], got \[3, 5\]"),
        ({"image": (IMAGE, "H W 4")}, r"image: expected \[H=4, W=5, 4\], got \[4, 5, 3\]"),
        ({"image": (IMAGE, "H W")}, r"image: expected \[H, W\], got \[4, 5, 3\]"),
        ({"square": (PLANE, "N N")}, r"square: expected \[N=4, N=4\], got \[4, 5\]"),
        ({"plane": (PLANE.double(), "H W")}, r"plane: expected float32, got torch\.float64"),
        ({"plane": (None, "H W")}, r"plane: expected a tensor \[H, W\], got NoneType"),
        ({"plane": (PLANE, "H W"), "other": (PLANE.to("meta"), "H W")}, "other: expected device cpu .*, got meta"),
        ({"image": (IMAGE, "H W 3"), "mask": (PLANE[:3], "? H W")}, r"mask: expected \[H=4, W=5\], got \[3, 5\]"),
    ],
)
def test_what_does_not_fit_is_named(specs: dict[str, tuple[torch.Tensor | None, str]], message: str) -> None:
    with pytest.raises(TensorError, match=message):
        check_tensors(None, **specs)


def test_what_may_be_missing() -> None:
    assert check_tensors(image=(IMAGE, "H W 3"), mask=(None, "? H W")) == {"H": 4, "W": 5}
    assert check_tensors(image=(IMAGE, "H W 3"), mask=(PLANE, "? H W")) == {"H": 4, "W": 5}
