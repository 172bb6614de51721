"""Cost model of a run's steps, in seconds of a reference machine: two idle cores with AVX2 kernels.

The numbers are fitted to runs with 32 to 264 pixels a side, 8 to 62 views, and the presets draft and standard. The cost
of a step varies by up to 50% between scenes. The planner measures the speed of the actual machine relative to the
reference.
"""

from __future__ import annotations

from collections.abc import Mapping

from mgsr.config import Config, GaussianConfig, MeshConfig, SurfelConfig, starting_settings
from mgsr.config.expert import SceneStereoOptions
from mgsr.data.cost_factors import CostFactors
from mgsr.data.image_pairs import pair_count
from mgsr.data.scene import PHOTOGRAPHS
from mgsr.mesh.steps import mesh_steps
from mgsr.mesh.steps.step import rendered_pixels, surface_cells

LOADING, LOADED = 0.15, 0.01  # seconds of reading: of any capture, and per view of the usual size
SURFACE_PIXELS = 0.9  # area of an object's surface, in pixels of the photographs, per pixel of a view
GROWN = 0.15  # Gaussians added by error-driven growth, per pixel of a view
STEREO = 13.2  # seconds per megapixel that stereo searches, of all photographs together
FILLED = 0.1  # seconds per view for filling depths in regions without contrast
ADJUSTED = 0.2  # seconds per view for adjusting the cameras
STEREO_POINTS = 0.034  # starting points per pixel that stereo searches
ROUNDS, FLASH_ROUNDS = 3, 10  # rounds of refining the surface, without and with a flash
MODEL = 2.0  # seconds of unwrapping and baking
SEARCHED = 1.7  # seconds per view for finding the object's masks
LEARNED = 12.0  # seconds for learning masks from small photographs
MATTE_SURFACE, SHINY_SURFACE = 26.0, 43.0  # seconds for the first surface of the reference scene
STARTED = 2.0  # seconds for the visual hull and the starting points
FEATURE_PIXELS = 2400 * 1800  # photographs with more pixels are reduced before the search for features
MOST_FEATURES = 8192  # features in a photograph
MEGAPIXEL_FEATURES = 6900  # features per megapixel
USUAL_FEATURES = 1190  # features in a photograph of the fitted captures
DETECTED = 0.46  # seconds per megapixel for detecting features
MAPPED = 0.05  # seconds per photograph with the usual features for mapping
MATCHED = 0.0087  # seconds per pair of photographs with the usual features for matching
# Seconds of an iteration of training: of any, per view of the usual size, and per 10,000 splats.
SURFEL_ITERATION, GAUSSIAN_ITERATION = (0.0045, 0.011, 0.0025), (0.0045, 0.015, 0.0035)
MUTUAL = 1.15  # a mutual iteration over one of each branch
EXTRACTING, MESHED, RENDERED = 0.3, 12.0, 0.55  # seconds of extraction: of any, of the usual cells, and per megapixel
COMPARED, UNCOMPARED = 4.0, 0.1  # seconds of the scores of a surface with and without a true one
DRAWN, TEST_DRAWN, MOST_DRAWN = 2.0, 0.3, 6  # seconds of the surface's pictures, per test view, for at most so many
BAKED = 0.05  # seconds of the textured model per view of the usual size
REPORTED, TEST_SCORED = 0.8, 0.2  # seconds of the report, and per test view of the usual size


def load_cost(factors: CostFactors) -> float:
    """Return the seconds that reading the photographs takes."""
    return LOADING + LOADED * (factors.views + factors.tests) * factors.size


def cameras_cost(photographs: int, pixels: float, frames: bool) -> float:
    """Return the seconds that the search for the photographs' cameras takes.

    pixels: mean pixels of a photograph. frames: whether they are frames of a video; their choice is not counted.
    """
    megapixels = min(pixels, FEATURE_PIXELS) / 1e6
    features = min(MOST_FEATURES, MEGAPIXEL_FEATURES * megapixels) / USUAL_FEATURES
    pairs = pair_count(photographs, frames)
    return photographs * (DETECTED * megapixels + MAPPED * features) + pairs * MATCHED * features


def stereo_pixels(factors: CostFactors, most: int) -> float:
    """Return the pixels that stereo of everything in view searches in all photographs; most: the setting's limit."""
    return min(most, factors.pixels * min(factors.views, PHOTOGRAPHS))


def start_cost(factors: CostFactors, most: int = SceneStereoOptions().max_pixels) -> float:
    """Return the seconds that finding the starting points takes, on the hull or by stereo.

    most: the most pixels that the stereo of whole scenes searches.
    """
    search = SEARCHED * factors.views if factors.searched else 0.0
    depths = STEREO * stereo_pixels(factors, most) / 1e6 + FILLED * min(factors.views, PHOTOGRAPHS)
    everything = depths + ADJUSTED * factors.views
    if not factors.masked and not factors.learned:
        return search + everything
    surface = (SHINY_SURFACE if factors.shiny else MATTE_SURFACE) * factors.surface_work
    return search + everything * factors.searched + LEARNED * factors.learned + STARTED + surface


def iteration_cost(stage: str, factors: CostFactors, splats: Mapping[str, int]) -> float:
    """Return the seconds that one iteration of a stage of training takes, with so many splats in each branch."""
    flat, full = (splats.get(name, 0) / 10_000 for name in ("surfels", "gaussians"))
    surfels, gaussians = (
        each + per_size * factors.size + per_splats * count
        for (each, per_size, per_splats), count in ((SURFEL_ITERATION, flat), (GAUSSIAN_ITERATION, full))
    )
    if stage == "mutual":
        return MUTUAL * (surfels + gaussians)
    return surfels if stage == "warmup_surfels" or not full else gaussians


def usual_count(start: int, factors: CostFactors) -> int:
    """Return the usual final number of Gaussians of a branch that starts with `start` and grows by errors.

    Scenes differ much: matte toys need 0.02 Gaussians a pixel, and the scene lego needs 0.2.
    """
    return start + round(GROWN * factors.pixels)


def detail(factors: CostFactors, config: Config) -> float:
    """Return the factor on the number of surfels of a masked object (`StartConfig.detail`)."""
    area = factors.surface_pixels
    return config.expert.start.detail(SURFACE_PIXELS * factors.pixels if area is None else area)


def usual_points(factors: CostFactors, config: Config) -> int:
    """Return the usual number of starting points of a scene."""
    if factors.masked or factors.learned:
        most = max(config.train.surfels.max_start, config.train.gaussians.max_start)
        return round(detail(factors, config) * most)
    return round(STEREO_POINTS * stereo_pixels(factors, config.expert.start.stereo.max_pixels))


def usual_settings(factors: CostFactors, config: Config) -> tuple[SurfelConfig, GaussianConfig]:
    """Return both branches' settings as they usually hold for a scene (`starting_settings`)."""
    return starting_settings(config.train, factors.masked, usual_points(factors, config), detail(factors, config))


def surface_cost(factors: CostFactors, config: MeshConfig) -> float:
    """Return the seconds that rendering the surface's views and extracting it takes, without its refinement."""
    base = EXTRACTING + MESHED * surface_cells(factors, config) ** 2 + RENDERED * rendered_pixels(factors, config) / 1e6
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
    return (COMPARED if factors.truth else UNCOMPARED) + DRAWN + TEST_DRAWN * min(factors.tests, MOST_DRAWN)


def textured_cost(factors: CostFactors) -> float:
    """Return the seconds that the textured model takes."""
    return MODEL + BAKED * factors.views * factors.size


def closing_cost(factors: CostFactors) -> float:
    """Return the seconds that the textured model, the test renders, their scores and the report take."""
    return textured_cost(factors) + REPORTED + TEST_SCORED * factors.tests * factors.size
