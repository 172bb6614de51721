"""The benchmark's scenes in two sets: settings are chosen on the tuning set only, and both sets are reported.

The ready-made scenes lie in ../shared/data/scenes. The others are made from seeds by

    python -m benchmarks.render_scenes FOLDER

which runs ../shared/tools/render_scene.py with COMMON and the scene's own arguments, the latter winning.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class SceneSet(StrEnum):
    """What a scene may be used for: to choose settings, or only to judge them."""

    TUNING = "tuning"
    JUDGING = "judging"


class Kind(StrEnum):
    """What is hard about a scene. Each kind is in both sets."""

    MATTE = "matte"
    DARK = "dark"
    FLASH = "flash"
    GLOSS = "gloss"
    METAL = "metal"
    MIRROR = "mirror"
    CONCAVE = "concave"
    THIN = "thin"
    POOR_CAPTURE = "poor capture"
    ONE_SIDE = "one side"


class Cameras(StrEnum):
    """Where the cameras are: all around, above the object's middle, or within 45 degrees of +z."""

    FULL = "full"
    UPPER = "upper"
    CONE = "cone"


class Shape(StrEnum):
    """A solid that benchmarks/render_scenes.py builds."""

    BOWL = "bowl"
    CUP = "cup"
    RACK = "rack"
    CHAIR = "chair"
    BASKET = "basket"
    LANTERN = "lantern"
    MUSHROOM = "mushroom"
    VASE = "vase"


@dataclass(frozen=True)
class BenchmarkScene:
    """One scene of the benchmark.

    source: a file of ../shared/data/meshes, a shape, or None where the scene is ready-made; arguments: those of
    render_scene.py, parted by blanks.
    """

    name: str
    kind: Kind
    set: SceneSet
    source: str | Shape | None = None
    arguments: str = ""
    cameras: Cameras = Cameras.FULL


COMMON = "--res 256 --views 48 --test-views 8 --spp 64"

READY_MADE = (
    BenchmarkScene("spot_soft", Kind.MATTE, SceneSet.TUNING),
    BenchmarkScene("bunny_flash", Kind.FLASH, SceneSet.TUNING),
    BenchmarkScene("teapot_hdr", Kind.GLOSS, SceneSet.TUNING),
    BenchmarkScene("wingnut_dark", Kind.DARK, SceneSet.TUNING),
    BenchmarkScene("bob_chrome_hdr", Kind.MIRROR, SceneSet.TUNING),
    BenchmarkScene("fandisk_copper_hdr", Kind.METAL, SceneSet.TUNING),
    BenchmarkScene("rockerarm_dark", Kind.DARK, SceneSet.TUNING),
    BenchmarkScene("lion_soft", Kind.THIN, SceneSet.TUNING),
    BenchmarkScene("boot_hdr_400", Kind.CONCAVE, SceneSet.TUNING),
)

# Light reaches the inside of bowl, cup and vase, and the mushroom's gills, along few paths: they take more samples
# than COMMON, or it is all grain. With --up z, the front of the figures in homer.obj and hand.obj faces +z, where the
# cone's cameras are.
RENDERED = (
    BenchmarkScene(
        "homer_gold_hdr",
        Kind.METAL,
        SceneSet.TUNING,
        "homer.obj",
        "--up y --material conductor --metal Au --roughness 0.1 --light hdr --seed 201",
    ),
    BenchmarkScene(
        "bowl_soft",
        Kind.CONCAVE,
        SceneSet.TUNING,
        Shape.BOWL,
        "--up z --tilt 20 --solid marble --freq 3 --color 0.70,0.58,0.36 --color2 0.12,0.16,0.30 --light soft "
        "--spp 192 --seed 202",
    ),
    BenchmarkScene(
        "mushroom_soft",
        Kind.CONCAVE,
        SceneSet.TUNING,
        Shape.MUSHROOM,
        "--up z --tilt 15 --solid marble --freq 4 --color 0.66,0.52,0.36 --color2 0.24,0.12,0.07 --light soft --spp 96 "
        "--seed 208",
    ),
    BenchmarkScene(
        "homer_cone",
        Kind.ONE_SIDE,
        SceneSet.TUNING,
        "homer.obj",
        "--up z --views 32 --solid marble --freq 5 --color 0.72,0.60,0.45 --color2 0.20,0.12,0.08 --light sky "
        "--seed 203",
        Cameras.CONE,
    ),
    BenchmarkScene(
        "plane_sky",
        Kind.MATTE,
        SceneSet.JUDGING,
        "plane.obj",
        "--up z --tilt 35 --rotz 20 --solid stripes --freq 5 --color 0.70,0.68,0.62 --color2 0.10,0.16,0.40 "
        "--light sky --seed 204",
    ),
    BenchmarkScene(
        "penguin_black_hdr",
        Kind.GLOSS,
        SceneSet.TUNING,
        "penguin.obj",
        "--up y --color 0.01,0.01,0.01 --material plastic --roughness 0.05 --light hdr --white 0.06 --seed 205",
    ),
    BenchmarkScene(
        "hand_aluminium_hdr",
        Kind.METAL,
        SceneSet.JUDGING,
        "hand.obj",
        "--up y --rotz 30 --material conductor --metal Al --roughness 0.3 --light hdr --seed 206",
    ),
    BenchmarkScene(
        "cow_flash_16",
        Kind.POOR_CAPTURE,
        SceneSet.TUNING,
        "cow.obj",
        "--up y --views 16 --solid blobs --freq 5 --color 0.60,0.55,0.48 --color2 0.14,0.08,0.05 --material plastic "
        "--roughness 0.15 --light flash --seed 207",
    ),
    BenchmarkScene(
        "cheburashka_mirror_hdr",
        Kind.MIRROR,
        SceneSet.JUDGING,
        "cheburashka.obj",
        "--up y --rotz 40 --material conductor --metal Ag --roughness 0.01 --light hdr --light-seed 31 --seed 301",
    ),
    BenchmarkScene(
        "fish_satin_flash",
        Kind.FLASH,
        SceneSet.JUDGING,
        "fish.obj",
        "--up y --solid stripes --freq 4 --color 0.55,0.35,0.10 --color2 0.08,0.18,0.28 --material satin "
        "--light flash --seed 302",
    ),
    BenchmarkScene(
        "cup_coat_hdr",
        Kind.CONCAVE,
        SceneSet.TUNING,
        Shape.CUP,
        "--up z --tilt 15 --rotz 60 --solid blobs --freq 4 --color 0.50,0.42,0.30 --color2 0.06,0.18,0.22 "
        "--material clearcoat --light hdr --spp 128 --seed 303",
    ),
    BenchmarkScene(
        "vase_sky",
        Kind.CONCAVE,
        SceneSet.JUDGING,
        Shape.VASE,
        "--up z --tilt 25 --rotz 10 --solid stripes --freq 4 --color 0.62,0.40,0.24 --color2 0.16,0.22,0.30 "
        "--material satin --light sky --spp 128 --seed 309",
    ),
    BenchmarkScene(
        "penguin_cone",
        Kind.ONE_SIDE,
        SceneSet.JUDGING,
        "penguin.obj",
        "--up z --views 32 --solid blobs --freq 4 --color 0.58,0.54,0.46 --color2 0.14,0.16,0.22 --material plastic "
        "--roughness 0.2 --light soft --seed 310",
        Cameras.CONE,
    ),
    BenchmarkScene(
        "brucewick_porcelain_hdr",
        Kind.GLOSS,
        SceneSet.JUDGING,
        "brucewick.obj",
        "--up y --shading crease:70 --color 0.75,0.75,0.75 --material plastic --roughness 0.05 --light hdr --white 0.6 "
        "--seed 304",
    ),
    BenchmarkScene(
        "rack_soft",
        Kind.THIN,
        SceneSet.TUNING,
        Shape.RACK,
        "--up z --tilt 25 --rotz 35 --solid checker --freq 9 --color 0.72,0.66,0.50 --color2 0.18,0.10,0.12 "
        "--light soft --seed 305",
    ),
    BenchmarkScene(
        "chair_sky",
        Kind.THIN,
        SceneSet.TUNING,
        Shape.CHAIR,
        "--up z --tilt 20 --rotz 15 --solid stripes --freq 7 --color 0.68,0.46,0.24 --color2 0.22,0.12,0.07 "
        "--material satin --light sky --seed 406",
    ),
    BenchmarkScene(
        "basket_soft",
        Kind.THIN,
        SceneSet.TUNING,
        Shape.BASKET,
        "--up z --tilt 15 --rotz 5 --solid blobs --freq 7 --color 0.70,0.56,0.34 --color2 0.16,0.10,0.12 "
        "--light soft --seed 405",
    ),
    BenchmarkScene(
        "lantern_sky",
        Kind.THIN,
        SceneSet.JUDGING,
        Shape.LANTERN,
        "--up z --tilt 20 --rotz 25 --solid checker --freq 7 --color 0.60,0.62,0.48 --color2 0.14,0.16,0.22 "
        "--material plastic --roughness 0.2 --light sky --seed 407",
    ),
    BenchmarkScene(
        "cow_upper_exposure",
        Kind.POOR_CAPTURE,
        SceneSet.JUDGING,
        "cow.obj",
        "--up y --rotz 25 --solid blobs --freq 4 --color 0.62,0.58,0.50 --color2 0.20,0.10,0.06 --light sky "
        "--exposure-jitter 0.7 --noise 1.5 --seed 306",
        Cameras.UPPER,
    ),
    BenchmarkScene(
        "brucewick_dark",
        Kind.DARK,
        SceneSet.TUNING,
        "brucewick.obj",
        "--up y --solid stripes --freq 5 --color 0.60,0.30,0.15 --color2 0.12,0.22,0.35 --material plastic "
        "--roughness 0.2 --light dark --noise 2 --seed 308",
    ),
    BenchmarkScene(
        "cheburashka_dark",
        Kind.DARK,
        SceneSet.JUDGING,
        "cheburashka.obj",
        "--up y --rotz 15 --solid blobs --freq 5 --color 0.58,0.40,0.22 --color2 0.14,0.20,0.30 --material plastic "
        "--roughness 0.25 --light dark --noise 2 --seed 402",
    ),
    BenchmarkScene(
        "fish_black_hdr",
        Kind.GLOSS,
        SceneSet.JUDGING,
        "fish.obj",
        "--up y --rotz 20 --color 0.012,0.012,0.012 --material plastic --roughness 0.08 --light hdr --white 0.06 "
        "--seed 403",
    ),
    BenchmarkScene(
        "brucewick_cone",
        Kind.ONE_SIDE,
        SceneSet.TUNING,
        "brucewick.obj",
        "--up z --views 32 --solid blobs --freq 4 --color 0.62,0.50,0.40 --color2 0.20,0.12,0.16 --material plastic "
        "--roughness 0.3 --light soft --seed 311",
        Cameras.CONE,
    ),
    BenchmarkScene(
        "hand_cone_hdr",
        Kind.ONE_SIDE,
        SceneSet.TUNING,
        "hand.obj",
        "--up z --views 32 --solid stripes --freq 6 --color 0.60,0.42,0.30 --color2 0.12,0.16,0.24 "
        "--material clearcoat --light hdr --seed 307",
        Cameras.CONE,
    ),
)

SCENES = READY_MADE + RENDERED
