"""Statistics that outliers hardly change."""

from __future__ import annotations

import numpy as np


def robust_deviation(residuals: np.ndarray) -> float:
    """Return the standard deviation of residuals [...] around 0, from their median absolute value.

    1.4826 is the ratio of both for normally distributed residuals.
    """
    return 1.4826 * float(np.median(np.abs(residuals)))
