"""Time to read photographs, beside what OpenImageIO takes to decode them alone on the same cores.

    python benchmarks/reading.py [--count 100] [--width 1633] [--height 1225] [--runs 3] [--suffix .jpg] [FOLDER]

Without FOLDER, photographs of that size are made in a temporary folder: smooth with some noise, as cameras' files are.
Each row is a way to read:

- `decode`: OpenImageIO alone, which may reuse the same memory.
- `kept`: the same, but all images stay in memory, as a reader must keep them.
- `remapped`: decoding and OpenCV's remapping of bytes on prepared maps, by `linear` or `cubic` interpolation.
- `views`: MGSR's reader without reduction or undistortion.
- `reduced`: MGSR's reader, with photographs reduced to 1,000 pixels.
- `lens`, `lenses`: MGSR's reader with undistortion, by one lens or by one lens per photograph.
- `reduced, lens`: both reduction and undistortion.

`cpu` is processor time, which other programs on the machine disturb less. The ratios are to `decode`, of the medians of
alternating runs.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import OpenImageIO

from mgsr.config import DataConfig
from mgsr.data.capture import Photo
from mgsr.data.files import images_below
from mgsr.data.images import image_size
from mgsr.data.lens import Lens
from mgsr.data.loading import load_views
from mgsr.data.undistortion import Undistortion, undistortion
from mgsr.parallel import core_count

LENS = Lens(-0.12, 0.05, 0.001, -0.001)


def main() -> None:
    given = arguments()
    with tempfile.TemporaryDirectory() as folder:
        if given.folder is None:
            make_photographs(Path(folder), given.count, given.width, given.height, given.suffix)
        images = images_below(given.folder or Path(folder))
        report(images, given.runs)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--width", type=int, default=1633)
    parser.add_argument("--height", type=int, default=1225)
    parser.add_argument("--suffix", default=".jpg")
    parser.add_argument("--runs", type=int, default=3)
    return parser.parse_args()


def make_photographs(folder: Path, count: int, width: int, height: int, suffix: str) -> None:
    rng = np.random.default_rng(0)
    for i in range(count):
        coarse = OpenImageIO.ImageBuf(rng.random((height // 20, width // 20, 3), dtype=np.float32))
        smooth = OpenImageIO.ImageBufAlgo.resize(coarse, roi=OpenImageIO.ROI(0, width, 0, height, 0, 1, 0, 3))
        pixels = smooth.get_pixels()
        assert pixels is not None, smooth.geterror()
        noisy = pixels + rng.normal(0, 0.01, (height, width, 3)).astype(np.float32)
        picture = OpenImageIO.ImageBuf(np.ascontiguousarray(noisy))
        picture.set_write_format("uint8")
        picture.write(str(folder / f"{i:04d}{suffix}"))


def report(images: Sequence[Path], runs: int) -> None:
    size = image_size(images[0], "the benchmark")
    one = [LENS] * len(images)
    each = [replace(LENS, k1=LENS.k1 + 1e-4 * i) for i in range(len(images))]
    how = undistortion(LENS, calibration(size), *size, "the benchmark")
    ways: dict[str, Callable[[], None]] = {
        "decode": lambda: in_parallel(decode, images),
        "decode, kept": lambda: in_parallel(decode, images, keep=True),
        "remapped, linear": lambda: in_parallel(lambda image: remap(image, how, cv2.INTER_LINEAR), images, keep=True),
        "remapped, cubic": lambda: in_parallel(lambda image: remap(image, how, cv2.INTER_CUBIC), images, keep=True),
        "views": lambda: read(images, size, None, max(size)),
        "reduced": lambda: read(images, size, None, 1000),
        "lens": lambda: read(images, size, one, max(size)),
        "lenses": lambda: read(images, size, each, max(size)),
        "reduced, lens": lambda: read(images, size, one, 1000),
    }
    seconds: dict[str, list[tuple[float, float]]] = {name: [] for name in ways}
    for _ in range(runs):
        for name, way in ways.items():
            started_at, used = time.perf_counter(), time.process_time()
            way()
            seconds[name].append((time.perf_counter() - started_at, time.process_time() - used))
    print(f"{len(images)} images of {size[0]}x{size[1]}, {core_count(None)} cores, {runs} runs")
    print(f"{'':18}{'ms an image':>12}{'ratio':>8}{'cpu ms':>10}{'ratio':>8}")
    medians = {
        name: [statistics.median(column) for column in zip(*rows, strict=True)] for name, rows in seconds.items()
    }
    bare = medians["decode"]
    for name, (wall, cpu) in medians.items():
        unit = 1e3 / len(images)
        print(f"{name:18}{wall * unit:12.1f}{wall / bare[0]:8.2f}{cpu * unit:10.1f}{cpu / bare[1]:8.2f}")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    pixels = len(images) * size[0] * size[1] * 3 / 2**20
    print(f"memory at most {peak:.0f} MiB, of which {pixels:.0f} MiB are the images of one reading")


def in_parallel(work: Callable[[Path], np.ndarray], images: Sequence[Path], keep: bool = False) -> None:
    kept = []
    with ThreadPoolExecutor(core_count(None)) as pool:
        for pixels in pool.map(work, images):
            if keep:
                kept.append(pixels)


def decode(image: Path) -> np.ndarray:
    handle = OpenImageIO.ImageInput.open(str(image))
    assert handle is not None, OpenImageIO.geterror()
    pixels = handle.read_image(0, 0, 0, handle.spec().nchannels, "uint8")
    assert pixels is not None, handle.geterror()
    handle.close()
    return pixels


def remap(image: Path, how: Undistortion, interpolation: int) -> np.ndarray:
    return cv2.remap(decode(image), how.map_x, how.map_y, interpolation, borderMode=cv2.BORDER_REPLICATE)


def read(images: Sequence[Path], size: tuple[int, int], lenses: Sequence[Lens] | None, max_side: int) -> None:
    of_images: Sequence[Lens | None] = lenses or [None] * len(images)
    photos = [
        Photo(image, calibration(size), size, np.eye(4), image.name, lens=lens)
        for image, lens in zip(images, of_images, strict=True)
    ]
    load_views(photos, [image.stem for image in images], DataConfig(max_side=max_side))


def calibration(size: tuple[int, int]) -> np.ndarray:
    return np.array([[size[0], 0, size[0] / 2], [0, size[0], size[1] / 2], [0, 0, 1.0]])


if __name__ == "__main__":
    main()
