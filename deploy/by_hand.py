"""Build the images' file systems without Docker, by executing the Dockerfiles in chroots.

debootstrap --variant=minbase bookworm BASE
python deploy/by_hand.py BASE OUT [--only service] [--build-arg NAME=VALUE] [--bind PATH[:INSIDE]]

Needs root. OUT/<image> becomes the root of the final stage, and OUT/<image>.json has its ENV, USER, WORKDIR,
HEALTHCHECK and CMD. BASE replaces every FROM that names no stage. --bind mounts a path of this machine read-only for
the commands, such as certificates or a package index. PIP_* variables are passed on. Instructions that our Dockerfiles
do not use are refused.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ("service", "worker-cpu", "worker-gpu")
Instruction = tuple[str, str]


@dataclass
class Stage:
    """A root folder, and the image's settings for it."""

    root: Path
    env: dict[str, str] = field(default_factory=dict)
    workdir: str = "/"
    user: str = "0:0"
    command: list[str] = field(default_factory=list)
    health: list[str] = field(default_factory=list)


def read_dockerfile(text: str) -> list[Instruction]:
    """Return the instructions of a Dockerfile in order, as name and rest, with continued lines joined."""
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    joined = re.sub(r"\\\n\s*", "", "\n".join(lines))
    return [(line.split(maxsplit=1)[0].upper(), line.split(maxsplit=1)[1]) for line in joined.splitlines()]


def stages(instructions: list[Instruction]) -> Iterator[tuple[str, list[Instruction]]]:
    """Yield each stage's name and its instructions after FROM. The last stage has an empty name.

    Raises ValueError for another instruction than ARG before the first FROM.
    """
    found: list[tuple[str, list[Instruction]]] = []
    for name, rest in instructions:
        if name == "FROM":
            found.append((rest.partition(" AS ")[2], []))
        elif found:
            found[-1][1].append((name, rest))
        elif name != "ARG":
            raise ValueError(f"{name}: expected only ARG before FROM; move it into a stage")
    yield from found


class Builder:
    """A builder of stages, which builds equal stages of several Dockerfiles only once."""

    def __init__(self, base: Path, out: Path, args: dict[str, str], binds: list[str]) -> None:
        self._base, self._out, self._args, self._binds = base, out, args, binds
        self._made: dict[str, Stage] = {}

    def build(self, image: str) -> Stage:
        """Return the final stage of deploy/Dockerfile.<image>."""
        named: dict[str, Stage] = {}
        last = None
        for name, instructions in stages(read_dockerfile((ROOT / f"deploy/Dockerfile.{image}").read_text())):
            key = repr((name, instructions))
            if key not in self._made:
                folder = self._out / (f".{len(self._made)}.{name}" if name else image)
                self._made[key] = self._stage(folder, instructions, named)
            last = named[name] = self._made[key]
        assert last is not None, image
        return last

    def _stage(self, root: Path, instructions: list[Instruction], named: dict[str, Stage]) -> Stage:
        shutil.rmtree(root, ignore_errors=True)
        subprocess.run(["cp", "-a", "--reflink=auto", self._base, root], check=True)
        stage = Stage(root)
        args: dict[str, str] = {}
        for name, rest in instructions:
            print(f"{root.name}: {name} {rest[:110]}", flush=True)
            if name == "RUN":
                self._run(stage, args, rest)
            elif name == "COPY":
                _copy(stage, rest, named)
            elif name == "ENV":
                for word in shlex.split(rest):
                    key, _, value = word.partition("=")
                    stage.env[key] = value.replace("$PATH", _PATH)
            elif name == "ARG":
                key, _, value = rest.partition("=")
                args[key] = self._args.get(key, value)
            elif name == "WORKDIR":
                stage.workdir = rest
                (root / rest.lstrip("/")).mkdir(parents=True, exist_ok=True)
            elif name == "USER":
                stage.user = rest
            elif name == "CMD":
                stage.command = json.loads(rest)
            elif name == "HEALTHCHECK":
                stage.health = json.loads(rest.split("CMD", 1)[1])
            elif name != "EXPOSE":
                raise ValueError(f"{name}: this script does not support the instruction; add it to Builder._stage")
        return stage

    def _run(self, stage: Stage, args: dict[str, str], command: str) -> None:
        passed = {key: value for key, value in os.environ.items() if key.startswith("PIP_")}
        with mounted(stage.root, self._binds):
            subprocess.run(
                ["chroot", str(stage.root), "/bin/sh", "-c", f"cd {stage.workdir} && {command}"],
                env={"PATH": _PATH, "DEBIAN_FRONTEND": "noninteractive", **passed, **stage.env, **args},
                check=True,
            )


_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"


@contextmanager
def mounted(root: Path, binds: list[str]) -> Iterator[None]:
    """Mount /proc, /dev and paths of this machine inside a root for a block.

    The mounts are read-only, because installed packages may write there (certificates, for example), and would change
    this machine.
    """
    with ExitStack() as undo:
        for bind in ["/proc", "/dev", *binds]:
            path, _, place = bind.partition(":")
            inside = root / (place or path).lstrip("/")
            if Path(path).is_dir():
                inside.mkdir(parents=True, exist_ok=True)
            else:
                inside.parent.mkdir(parents=True, exist_ok=True)
                inside.touch()
            subprocess.run(["mount", "--bind", path, inside], check=True)
            undo.callback(partial(subprocess.run, ["umount", "-l", inside], check=True))
            subprocess.run(["mount", "-o", "remount,bind,ro", inside], check=True)
        yield


def _copy(stage: Stage, rest: str, named: dict[str, Stage]) -> None:
    words = rest.split()
    origin = ROOT
    if words[0].startswith("--from="):
        origin = named[words.pop(0).removeprefix("--from=")].root
    *sources, target = words
    place = stage.root / os.path.join(stage.workdir, target).lstrip("/")
    for source in sources:
        found = origin / source.lstrip("/")
        to = place / found.name if target.endswith("/") and found.is_file() else place
        to.parent.mkdir(parents=True, exist_ok=True)
        if found.is_dir():
            shutil.copytree(found, to, symlinks=True, dirs_exist_ok=True, ignore=_ignored if origin == ROOT else None)
        else:
            shutil.copy2(found, to)


# The files in copied folders that .dockerignore excludes.
_ignored = shutil.ignore_patterns("__pycache__", "*.so", "node_modules")


def main() -> None:
    """Build the images of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("base", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", choices=IMAGES, action="append")
    parser.add_argument("--build-arg", action="append", default=[])
    parser.add_argument("--bind", action="append", default=[])
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    builder = Builder(given.base, given.out, dict(arg.split("=", 1) for arg in given.build_arg), given.bind)
    for image in given.only or IMAGES:
        stage = builder.build(image)
        facts = {name: getattr(stage, name) for name in ("env", "workdir", "user", "command", "health")}
        (given.out / f"{image}.json").write_text(json.dumps(facts, indent=1) + "\n")
        size = subprocess.run(["du", "-sm", stage.root], check=True, capture_output=True, text=True).stdout.split()[0]
        print(f"{image}: {size} MB in {stage.root}", flush=True)


if __name__ == "__main__":
    main()
