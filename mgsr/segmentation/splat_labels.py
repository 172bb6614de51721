"""Segmentation of surfels: their connected pieces, and masks lifted from the photographs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from torch import Tensor

from mgsr.data.camera import Camera
from mgsr.gaussians.start import SH_CONSTANT
from mgsr.gaussians.surfels import SurfelModel
from mgsr.renderers.surfels import render_surfels


def pieces(points: np.ndarray, reach: float) -> np.ndarray:
    """Label each of the points [P,3] with its connected component, [P].

    Points closer than `reach`, in their unit, are connected. Component 0 has the most points.
    """
    pairs = cKDTree(points).query_pairs(reach, output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points),) * 2)
    count, found = connected_components(links, directed=False)
    order = np.argsort(-np.bincount(found, minlength=count), kind="stable")
    return np.asarray(np.argsort(order)[found])


def some_surfels(model: SurfelModel, chosen: np.ndarray) -> SurfelModel:
    """Return a model of the surfels where `chosen` [N] bool is True."""
    rows = torch.from_numpy(np.flatnonzero(chosen))
    return SurfelModel(**{name: tensor[rows] for name, tensor in model.parameters().items()})


def lifted_sums(model: SurfelModel, masks: Sequence[np.ndarray], cameras: Sequence[Camera]) -> np.ndarray:
    """Return the sums [N,K] of masks over the pixels that a surfel covers, weighted by its blending weights there.

    masks [H,W,K] bool or 0..1, one for each camera, K at most 3. Divided by the sum for a mask of ones, a surfel's sum
    is its label, 0..1.

    Source: the closed-form optimum of Shen and others 2024 (FlashSplat). Rendering is linear in the colours, so the
    blending weights are its derivatives.
    """
    total = torch.zeros(len(model), 3)
    for mask, camera in zip(masks, cameras, strict=True):
        colors = torch.zeros(len(model), 1, 3, requires_grad=True)
        rendered = render_surfels(_labelled(model, colors), camera, torch.zeros(3), 0).color
        asked = torch.zeros_like(rendered)
        asked[..., : mask.shape[-1]] = torch.from_numpy(mask.astype(np.float32))
        (rendered * asked).sum().backward()
        assert colors.grad is not None
        total += colors.grad[:, 0] / SH_CONSTANT
    return total[:, : masks[0].shape[-1]].numpy()


def _labelled(model: SurfelModel, colors: Tensor) -> SurfelModel:
    """Return the model with other harmonics [N,1,3], of degree 0, and without gradients elsewhere."""
    return replace(model.detached(), sh=colors)
