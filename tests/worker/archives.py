"""Archives that nobody should send, each with the code of its refusal."""

from __future__ import annotations

import io
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable
from typing import Literal

import zstandard


def zip_of(*members: tuple[str | zipfile.ZipInfo, bytes], packed: bool = True) -> bytes:
    """Return a zip of names and contents."""
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w", zipfile.ZIP_DEFLATED if packed else zipfile.ZIP_STORED) as target:
        for name, data in members:
            target.writestr(name, data)
    return held.getvalue()


def tar_of(*members: tuple[tarfile.TarInfo, bytes], mode: Literal["w", "w:gz"] = "w") -> bytes:
    """Return a tar of members and contents."""
    held = io.BytesIO()
    with tarfile.open(fileobj=held, mode=mode) as target:
        for member, data in members:
            target.addfile(member, io.BytesIO(data))
    return held.getvalue()


def zst(data: bytes) -> bytes:
    """Return data packed with zstd."""
    return zstandard.compress(data)


def plain(name: str, data: bytes) -> tuple[tarfile.TarInfo, bytes]:
    """Return an ordinary file of a tar."""
    member = tarfile.TarInfo(name)
    member.size = len(data)
    return member, data


def special(name: str, kind: bytes, target: str = "") -> tuple[tarfile.TarInfo, bytes]:
    """Return a link or a device of a tar."""
    member = tarfile.TarInfo(name)
    member.type, member.linkname, member.devmajor, member.devminor = kind, target, 1, 5
    return member, b""


def zip_link() -> bytes:
    """Return a zip with a symbolic link to the system's passwords, as `zip -y` stores it."""
    member = zipfile.ZipInfo("images/0.png")
    member.create_system, member.external_attr = 3, 0o120777 << 16
    return zip_of((member, b"/etc/passwd"))


def zip_that_claims_5_gb() -> bytes:
    """Return a zip with a stored member of ten bytes whose sizes say over four thousand million."""
    data = zip_of(("a.bin", b"0123456789"), packed=False)
    return data.replace(struct.pack("<II", 10, 10), struct.pack("<II", 4_294_967_294, 4_294_967_294))


def zip_that_lies_about_its_size() -> bytes:
    """Return a zip with a packed member of 20 MB whose sizes say ten bytes."""
    data = zip_of(("a.bin", bytes(20 << 20)))
    (packed,) = struct.unpack("<I", data[18:22])
    return data.replace(struct.pack("<II", packed, 20 << 20), struct.pack("<II", packed, 10))


def png_bomb(side: int, rows: int) -> bytes:
    """Return a black PNG of side x side pixels, with the data of so many rows: some kilobytes."""
    head = struct.pack(">IIBBBBB", side, side, 1, 0, 0, 0, 0)
    packed = zlib.compress(bytes((side // 8 + 1) * rows), 9)
    chunks = b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in ((b"IHDR", head), (b"IDAT", packed), (b"IEND", b""))
    )
    return b"\x89PNG\r\n\x1a\n" + chunks


def encrypted_zip() -> bytes:
    """Return a zip with a member whose flag says that it is encrypted."""
    data = bytearray(zip_of(("a.bin", b"0123456789")))
    data[6] |= 1
    data[data.rindex(b"PK\x01\x02") + 8] |= 1
    return bytes(data)


# Name: how to make it, and the code of the refusal. Limits: 50 files, 100 MiB unpacked, ratio 200, 1 million pixels.
MALICIOUS: dict[str, tuple[Callable[[], bytes], str]] = {
    "zip_parent": (lambda: zip_of(("../../evil.txt", b"x")), "archive_unsafe_member"),
    "zip_parent_windows": (lambda: zip_of(("..\\..\\evil.txt", b"x")), "archive_unsafe_member"),
    "zip_absolute": (lambda: zip_of(("/tmp/evil.txt", b"x")), "archive_unsafe_member"),
    "zip_drive": (lambda: zip_of(("C:/evil.txt", b"x")), "archive_unsafe_member"),
    "zip_link": (zip_link, "archive_unsafe_member"),
    "zip_twice": (lambda: zip_of(("a", b"x"), ("A/../a", b"y")), "archive_unsafe_member"),
    "zip_file_as_folder": (lambda: zip_of(("a", b"x"), ("a/b", b"y")), "archive_unsafe_member"),
    "zip_control_characters": (lambda: zip_of(("a\x1b[2Jb", b"x")), "archive_unsafe_member"),
    "zip_long_name": (lambda: zip_of(("a" * 300, b"x")), "archive_unsafe_member"),
    "zip_encrypted": (encrypted_zip, "archive_unsafe_member"),
    "zip_many": (lambda: zip_of(*[(f"{i}.txt", b"") for i in range(60)]), "archive_too_many_members"),
    "zip_bomb": (lambda: zip_of(("a.bin", bytes(90 << 20))), "archive_ratio"),
    "zip_large": (lambda: zip_of(*[(f"{i}.bin", bytes(30 << 20)) for i in range(4)]), "archive_ratio"),
    "zip_claims_5_gb": (zip_that_claims_5_gb, "archive_damaged"),
    "zip_lies": (zip_that_lies_about_its_size, "archive_damaged"),
    "zip_cut": (lambda: zip_of(("a.bin", bytes(range(256)) * 40))[:-40], "archive_damaged"),
    "tar_parent": (lambda: tar_of(plain("../evil.txt", b"x")), "archive_unsafe_member"),
    "tar_absolute": (lambda: tar_of(plain("/tmp/evil.txt", b"x")), "archive_unsafe_member"),
    "tar_symbolic_link": (lambda: tar_of(special("a", tarfile.SYMTYPE, "/etc")), "archive_unsafe_member"),
    "tar_hard_link": (lambda: tar_of(special("a", tarfile.LNKTYPE, "/etc/passwd")), "archive_unsafe_member"),
    "tar_device": (lambda: tar_of(special("a", tarfile.CHRTYPE)), "archive_unsafe_member"),
    "tar_pipe": (lambda: tar_of(special("a", tarfile.FIFOTYPE)), "archive_unsafe_member"),
    "tar_gz_bomb": (lambda: tar_of(plain("a.bin", bytes(90 << 20)), mode="w:gz"), "archive_ratio"),
    "tar_gz_cut": (lambda: tar_of(plain("a.bin", bytes(9 << 20)), mode="w:gz")[:-2000], "archive_damaged"),
    "tar_zst_parent": (lambda: zst(tar_of(plain("../evil.txt", b"x"))), "archive_unsafe_member"),
    "tar_zst_bomb": (lambda: zst(tar_of(plain("a.bin", bytes(90 << 20)))), "archive_ratio"),
    "tar_zst_cut": (lambda: zst(tar_of(plain("a.bin", bytes(range(256)) * 4000)))[:-20], "archive_damaged"),
    "nothing_in_it": (lambda: zip_of(), "bad_scene"),
    "image_bomb": (lambda: zip_of(("images/0.png", png_bomb(16_000, 16_000))), "image_too_large"),
    "image_claims_more": (lambda: zip_of(("images/0.png", png_bomb(80_000, 100))), "bad_scene"),
    "no_scene": (lambda: zip_of(("readme.txt", b"nothing here")), "bad_scene"),
}
