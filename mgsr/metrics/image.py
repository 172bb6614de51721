"""Image metrics, which compare a rendered image with a photograph.

Images are [H,W,3] float, sRGB 0..1.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter, minimum_filter

from mgsr.data.backdrop import WHITE, Color

C1, C2 = 0.01**2, 0.03**2  # the constants of SSIM, for values of 0..1


def composited(rgba: np.ndarray, background: Color = WHITE) -> np.ndarray:
    """Composite straight-alpha RGBA [H,W,4] on a colour, in sRGB, and return [H,W,3] float64; RGB stays as it is."""
    image = rgba.astype(np.float64)
    if image.shape[-1] == 3:
        return image
    alpha = image[..., 3:]
    on_color: np.ndarray = image[..., :3] * alpha + (1 - alpha) * np.array(background)
    return on_color


def decibels(error: float) -> float:
    """Return the PSNR of a mean squared error, at most 100 dB."""
    return float(-10 * np.log10(max(error, 1e-10)))


def psnr(truth: np.ndarray, image: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Return the PSNR, dB, of image [H,W,3] against truth [H,W,3], over all pixels or where mask [H,W] is True."""
    squares = (truth.astype(np.float64) - image) ** 2
    return decibels(float((squares if mask is None else squares[mask]).mean()))


def psnr_after_gain(truth: np.ndarray, image: np.ndarray, mask: np.ndarray) -> float:
    """Return the PSNR, dB, over the mask's pixels after the gain per channel that fits the image best to the truth.

    truth, image [H,W,3]; mask [H,W] bool.
    """
    target, given = truth[mask].astype(np.float64), image[mask].astype(np.float64)
    gain = (target * given).sum(0) / np.maximum((given**2).sum(0), 1e-9)
    return decibels(float(((target - np.clip(given * gain, 0, 1)) ** 2).mean()))


def ssim(truth: np.ndarray, image: np.ndarray, valid: np.ndarray | None = None) -> float:
    """Return the mean structural similarity of truth and image [H,W,3] over the channels and the pixels.

    The window is Gaussian, 11 x 11 with sigma 1.5, and the constants are C1 and C2. A pixel counts if its whole
    window lies inside the image, on valid pixels [H,W]; the result is NaN if no pixel counts. Source: Wang et al. 2004.
    """

    def blur(values: np.ndarray) -> np.ndarray:
        """Return the Gaussian mean of values [H,W,3] around each pixel."""
        return np.asarray(gaussian_filter(values, (1.5, 1.5, 0), truncate=3.5))

    a, b = truth.astype(np.float64), image.astype(np.float64)
    mean_a, mean_b = blur(a), blur(b)
    var_a, var_b, both = blur(a * a) - mean_a**2, blur(b * b) - mean_b**2, blur(a * b) - mean_a * mean_b
    value = (2 * mean_a * mean_b + C1) * (2 * both + C2)
    value /= (mean_a**2 + mean_b**2 + C1) * (var_a + var_b + C2)
    if valid is None:
        return float(value[5:-5, 5:-5].mean())
    whole = minimum_filter(valid, 11, mode="constant", cval=False)
    return float(value[whole].mean()) if whole.any() else float("nan")


def image_metrics(
    truth: np.ndarray, image: np.ndarray, valid: np.ndarray | None = None, background: Color = WHITE
) -> dict[str, float]:
    """Return the metrics of an image by name: psnr, ssim and, where the truth has an alpha, psnr_fg and psnr_fg_gain.

    The first two are on the background, the others on the object's pixels.
    truth, image [H,W,3 or 4]: RGB or straight-alpha RGBA, float 0..1 or uint8. valid [H,W] bool: the valid pixels of
    the truth, None for all; other pixels count in no metric.
    """
    truth, image = unit(truth), unit(image)
    target, given = composited(truth, background), composited(image, background)
    values = {"psnr": psnr(target, given, valid), "ssim": ssim(target, given, valid)}
    if truth.shape[-1] == 3:
        return values
    inside = truth[..., 3] > 0.5 if valid is None else (truth[..., 3] > 0.5) & valid
    if inside.any():
        values["psnr_fg"] = psnr(target, given, inside)
        values["psnr_fg_gain"] = psnr_after_gain(target, given, inside)
    return values


def unit(image: np.ndarray) -> np.ndarray:
    """Convert an image [H,W,C], uint8 or float 0..1, to float 0..1."""
    return image / 255.0 if image.dtype == np.uint8 else image
