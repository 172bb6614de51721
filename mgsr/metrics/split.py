"""The score of the light split: transmitted renders against the same views without any specular part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mgsr.metrics.image import psnr_after_gain, unit


@dataclass(frozen=True)
class SplitScore:
    """The score of a light split: PSNR, dB, on the object's pixels after a gain per channel.

    split_psnr: of the transmitted render; split_photo: of the photograph itself.
    """

    split_psnr: float
    split_photo: float

    @property
    def split_gain(self) -> float:
        """Return the split's gain, in dB; below zero it does harm."""
        return self.split_psnr - self.split_photo


def split_score(matte: np.ndarray, transmitted: np.ndarray, photo: np.ndarray) -> SplitScore:
    """Score the light split of one view.

    matte [H,W,4] without specular light; transmitted and photo [H,W,3 or 4] straight alpha; all float 0..1 or uint8.
    Pixels where matte's alpha is over a half count.
    """
    matte, transmitted, photo = unit(matte), unit(transmitted), unit(photo)
    inside = matte[..., 3] > 0.5
    truth = matte[..., :3]
    return SplitScore(
        psnr_after_gain(truth, transmitted[..., :3], inside), psnr_after_gain(truth, photo[..., :3], inside)
    )


def mean_split(scores: list[SplitScore]) -> SplitScore:
    """Return the mean score over views."""
    return SplitScore(
        float(np.mean([score.split_psnr for score in scores])), float(np.mean([score.split_photo for score in scores]))
    )
