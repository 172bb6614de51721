"""The mirrored light's file."""

from pathlib import Path

import numpy as np
import pytest

from mgsr.errors import SceneError
from mgsr.export.mirrored_light import load_mirrored_light, write_mirrored_light


def test_what_is_written_is_read(tmp_path: Path) -> None:
    maps = np.random.default_rng(0).random((2, 3, 4, 4)).astype(np.float32)
    write_mirrored_light(tmp_path / "light.npz", maps)
    assert np.array_equal(load_mirrored_light(tmp_path / "light.npz"), maps)
    with np.load(tmp_path / "light.npz") as content:  # as its own description says, without our reader
        assert np.array_equal(content["camera"][1, 2], maps[1, :, 1, 2])


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04 broken"])
def test_a_broken_file_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "light.npz"
    path.write_bytes(content)
    with pytest.raises(SceneError, match=r"light\.npz: not a mirrored light"):
        load_mirrored_light(path)


@pytest.mark.parametrize(
    "arrays",
    [
        {"scene": np.zeros((4, 4, 3))},
        {"scene": np.zeros((4, 4, 3)), "camera": np.zeros((5, 5, 3))},
        {"scene": np.full((4, 4, 3), np.nan), "camera": np.zeros((4, 4, 3))},
    ],
)
def test_other_arrays_are_refused(tmp_path: Path, arrays: dict[str, np.ndarray]) -> None:
    np.savez(tmp_path / "light.npz", **arrays)
    with pytest.raises(SceneError, match=r"light\.npz"):
        load_mirrored_light(tmp_path / "light.npz")
