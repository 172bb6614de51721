"""Cost model of a run's steps, in seconds of a reference machine: two idle cores with AVX2 kernels.

The numbers are fitted to runs with 32 to 264 pixels a side, 8 to 62 views, and the presets draft and standard. The cost
of a step varies by up to 50% between scenes. The planner measures the speed of the actual machine relative to the
reference.
"""

from __future__ import annotations

from collections.abc import Mapping

from mgsr.config import Config, MeshConfig
from mgsr.config.expert import SceneStereoOptions
from mgsr.data.cost_factors import CostFactors
from mgsr.data.image_pairs import pair_count
from mgsr.data.scene import PHOTOGRAPHS
from mgsr.mesh.steps import mesh_steps
from mgsr.mesh.steps.step import rendered_pixels, surface_cells

GROWN = 0.15  # Gaussians added by error-driven growth, per pixel of a view
STEREO = 13.2  # seconds per megapixel that stereo searches, of all photographs together
FILLED = 0.1  # seconds per view for filling depths in regions without contrast
STEREO_POINTS = 0.034  # starting points per pixel that stereo searches
ROUNDS, FLASH_ROUNDS = 3, 10  # rounds of refining the surface, without and with a flash
MODEL = 2.0  # seconds of unwrapping and baking
SEARCHED = 1.9  # seconds per view for finding the object's masks
LEARNED = 12.0  # seconds for learning masks from small photographs
FEATURE_PIXELS = 2400 * 1800  # photographs with more pixels are reduced before the search for features
MOST_FEATURES = 8192  # features in a photograph


def load_cost(factors: CostFactors) -> float:
    """Return the seconds that reading the photographs takes."""
    return 0.15 + 0.01 * (factors.views + factors.tests) * factors.size


def cameras_cost(photographs: int, pixels: float, frames: bool) -> float:
    """Return the seconds that the search for the photographs' cameras takes.

    pixels: mean pixels of a photograph. frames: whether they are frames of a video; their choice is not counted.
    """
    megapixels = min(pixels, FEATURE_PIXELS) / 1e6
    features = min(MOST_FEATURES, 6900 * megapixels) / 1190
    return photographs * (0.46 * megapixels + 0.05 * features) + pair_count(photographs, frames) * 0.0087 * features


def stereo_pixels(factors: CostFactors, most: int) -> float:
    """Return the pixels that stereo of everything in view searches in all photographs; most: the setting's limit."""
    return min(most, factors.pixels * min(factors.views, PHOTOGRAPHS))


def start_cost(factors: CostFactors, most: int = SceneStereoOptions().max_pixels) -> float:
    """Return the seconds that finding the starting points takes, on the hull or by stereo.

    most: the most pixels that the stereo of whole scenes searches.
    """
    search = SEARCHED * factors.views if factors.searched else 0.0
    everything = STEREO * stereo_pixels(factors, most) / 1e6 + FILLED * min(factors.views, PHOTOGRAPHS)
    if not factors.masked and not factors.learned:
        return search + everything
    surface = (43.0 if factors.shiny else 26.0) * (factors.views / 48 * factors.size) ** 0.7
    seconds: float = search + everything * factors.searched + LEARNED * factors.learned + 2.0 + surface
    return seconds


def iteration_cost(stage: str, factors: CostFactors, splats: Mapping[str, int]) -> float:
    """Return the seconds that one iteration of a stage of training takes, with so many splats in each branch."""
    flat, full = (splats.get(name, 0) / 10_000 for name in ("surfels", "gaussians"))
    surfels = 0.0045 + 0.011 * factors.size + 0.0025 * flat
    gaussians = 0.0045 + 0.015 * factors.size + 0.0035 * full
    if stage == "mutual":
        return 1.15 * (surfels + gaussians)
    return surfels if stage == "warmup_surfels" or not full else gaussians


def usual_count(start: int, factors: CostFactors) -> int:
    """Return the usual final number of Gaussians of a branch that starts with `start` and grows by errors.

    Scenes differ much: matte toys need 0.02 Gaussians a pixel, and the scene lego needs 0.2.
    """
    return start + round(GROWN * factors.pixels)


def usual_points(factors: CostFactors, config: Config) -> int:
    """Return the usual number of starting points of a scene."""
    if factors.masked or factors.learned:
        return max(config.train.surfels.max_start, config.train.gaussians.max_start)
    return round(STEREO_POINTS * stereo_pixels(factors, config.expert.start.stereo.max_pixels))


def surface_cost(factors: CostFactors, config: MeshConfig) -> float:
    """Return the seconds that rendering the surface's views and extracting it takes, without its refinement."""
    base = 0.3 + 12.0 * surface_cells(factors, config) ** 2 + 0.55 * rendered_pixels(factors, config) / 1e6
    seconds: float = base + sum(step.cost(factors, config) for step in mesh_steps() if not step.refines)
    return seconds


def refinement_cost(factors: CostFactors, config: MeshConfig) -> float:
    """Return the seconds of all mesh steps that refine it against the photographs."""
    seconds: float = sum(step.cost(factors, config) for step in mesh_steps() if step.refines)
    return seconds


def mesh_cost(factors: CostFactors, config: MeshConfig, refined: float) -> float:
    """Return the seconds that the surface takes with a share `refined` of its refinement."""
    return surface_cost(factors, config) + refined * refinement_cost(factors, config)


def round_cost(factors: CostFactors, config: MeshConfig) -> float:
    """Return the seconds of one round of refinement, including preparation where it is needed."""
    return refinement_cost(factors, config) / (FLASH_ROUNDS if factors.flash else ROUNDS)


def judging_cost(factors: CostFactors) -> float:
    """Return the seconds that scores and pictures of the surface take."""
    return (4.0 if factors.truth else 0.1) + 2.0 + 0.3 * min(factors.tests, 6)


def textured_cost(factors: CostFactors) -> float:
    """Return the seconds that the textured model takes."""
    return MODEL + 0.05 * factors.views * factors.size


def closing_cost(factors: CostFactors) -> float:
    """Return the seconds that the textured model, the test renders, their scores and the report take."""
    return textured_cost(factors) + 0.8 + 0.2 * factors.tests * factors.size
