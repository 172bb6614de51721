"""Strangers' archives: what is good comes out whole, what is not is refused and leaves nothing outside."""

from __future__ import annotations

import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

from tests.worker.archives import MALICIOUS, plain, tar_of, zip_of
from worker.unpack import ArchiveError, Limits, check_images, unpack_archive

LIMITS = Limits(members=50, unpacked=100 << 20, ratio=200.0, pixels=1_000_000)
GOOD = {"transforms.json": b"{}", "images/0.png": bytes(range(256)) * 100, "images/deep/1.png": b""}


def unpack(data: bytes, folder: Path, limits: Limits = LIMITS) -> Path:
    (folder / "archive").write_bytes(data)
    unpack_archive(folder / "archive", folder / "scene", limits)
    check_images(folder / "scene", limits)
    return folder / "scene"


@pytest.mark.parametrize("kind", ["zip", "tar", "tar.gz"])
def test_a_good_archive_comes_out_whole(kind: str, tmp_path: Path) -> None:
    good = {name: data for name, data in GOOD.items() if not name.endswith(".png")} | {"images/a.bin": bytes(5000)}
    if kind == "zip":
        data = zip_of(("images/", b""), *good.items(), ("__MACOSX/._a", b"junk"))
    else:
        data = tar_of(*[plain(name, data) for name, data in good.items()], mode="w" if kind == "tar" else "w:gz")
    scene = unpack(data, tmp_path)
    found = {path.relative_to(scene).as_posix(): path.read_bytes() for path in scene.rglob("*") if path.is_file()}
    assert found == good


@pytest.mark.parametrize("name", [name for name, (_, code) in MALICIOUS.items() if code != "bad_scene"])
def test_a_bad_archive_is_refused(name: str, tmp_path: Path) -> None:
    make, code = MALICIOUS[name]
    with pytest.raises(ArchiveError) as refused:
        unpack(make(), tmp_path)
    assert refused.value.code == code, str(refused.value)
    assert {path.name for path in tmp_path.iterdir()} == {"archive", "scene"}
    assert not any(path.is_symlink() for path in tmp_path.rglob("*"))


def test_unpacked_bytes_are_counted_whatever_the_archive_says(tmp_path: Path) -> None:
    limits = Limits(members=50, unpacked=1 << 20, ratio=1e9, pixels=1_000_000)
    with pytest.raises(ArchiveError, match=r"'b.bin'.*limit of 1048576 bytes"):
        unpack(zip_of(("a.bin", bytes(1 << 19)), ("b.bin", bytes(1 << 20))), tmp_path, limits)
    written = sum(path.stat().st_size for path in (tmp_path / "scene").iterdir())
    assert written <= 1 << 20


def test_an_unknown_packing_is_refused(tmp_path: Path) -> None:
    data = bytearray(zip_of(("a.bin", b"0123456789")))
    data[8] = data[data.rindex(b"PK\x01\x02") + 10] = 97
    with pytest.raises(ArchiveError) as refused:
        unpack(bytes(data), tmp_path)
    assert refused.value.code == "archive_damaged"


def test_a_sparse_tar_is_refused(tmp_path: Path) -> None:
    """Five gigabytes of holes in half a kilobyte."""
    with (tmp_path / "holes").open("wb") as file:
        file.truncate(5 << 30)
    subprocess.run(["tar", "-C", tmp_path, "--sparse", "-cf", tmp_path / "t.tar", "holes"], check=True)
    assert (tmp_path / "t.tar").stat().st_size < 100_000
    with pytest.raises(ArchiveError) as refused:
        unpack((tmp_path / "t.tar").read_bytes(), tmp_path)
    assert refused.value.code == "archive_unsafe_member"


@pytest.mark.slow
def test_memory_stays_bounded(tmp_path: Path) -> None:
    """Hundreds of megabytes that unpack from a few, and a limit in their midst: only a few megabytes in memory."""
    with tarfile.open(tmp_path / "archive", "w:gz", compresslevel=1) as target:
        member = tarfile.TarInfo("a.bin")
        member.size = 400 << 20
        target.addfile(member, open("/dev/zero", "rb"))  # noqa: SIM115
    code = (
        "import sys, resource; from pathlib import Path; from worker.unpack import *\n"
        "limits = Limits(50, 200 << 20, 1e9, 10**6)\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "try: unpack_archive(Path(sys.argv[1]) / 'archive', Path(sys.argv[1]) / 'scene', limits)\n"
        "except ArchiveError as error: assert error.code == 'archive_too_large', error\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)"
    )
    ran = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, timeout=120)
    assert ran.returncode == 0, ran.stderr
    assert int(ran.stdout) * 1024 < 30 << 20
