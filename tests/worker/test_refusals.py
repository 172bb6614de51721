"""Strangers' archives, read as the job process does: each bad kind is refused by its code, and nothing of it stays."""

from __future__ import annotations

from pathlib import Path

import pytest

from mgsr.data.archive import ArchiveLimits, unpack
from mgsr.errors import ArchiveError
from tests.worker.archives import MALICIOUS, png_bomb, zip_of
from worker.images import check_images

LIMITS = ArchiveLimits(members=50, unpacked=100 << 20, ratio=200.0)
PIXELS = 1_000_000


@pytest.mark.parametrize("name", [name for name, (_, code) in MALICIOUS.items() if code != "bad_scene"])
def test_a_bad_archive_is_refused(name: str, tmp_path: Path) -> None:
    make, code = MALICIOUS[name]
    (tmp_path / "archive").write_bytes(make())
    with pytest.raises(ArchiveError, match=r"^archive: |^image ") as refused:
        unpack(tmp_path / "archive", tmp_path / "scene", LIMITS)
        check_images(tmp_path / "scene", PIXELS)
    assert refused.value.code == code, str(refused.value)
    assert {path.name for path in tmp_path.iterdir()} <= {"archive", "scene"}
    assert not any(path.is_symlink() for path in tmp_path.rglob("*"))


def test_an_image_at_the_limit_is_taken(tmp_path: Path) -> None:
    (tmp_path / "archive").write_bytes(zip_of(("images/0.png", png_bomb(1000, 1000))))
    unpack(tmp_path / "archive", tmp_path / "scene", LIMITS)
    check_images(tmp_path / "scene", PIXELS)
    with pytest.raises(
        ArchiveError, match=r"image images/0\.png: 1000x1000 pixels exceed the limit of 999999 in one image"
    ):
        check_images(tmp_path / "scene", PIXELS - 1)
