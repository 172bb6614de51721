"""Every command of the documentation is run, or says why it can't be; and those that are only named exist."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import typer.main
from typer.core import TyperGroup

from program.__main__ import app
from program.worker import app as worker_app
from tests.cli.spheres import write_spheres
from tests.docs.blocks import PAGES, ROOT, Block, blocks, script
from tests.service.stack import zip_folder

PROGRAMS = {"mgsr": "program", "mgsr-worker": "program.worker", "mgsr-service": "service.cli"}
ALL = {f"{block.page.name}:{i}": block for page in PAGES for i, block in enumerate(blocks(page))}
WITH_COMMANDS = [page for page in PAGES if script(page).strip() != "set -euo pipefail"]
COMMENTS = ("mgsr low_pass", "mgsr origin", "mgsr unit")  # of PLY files
KINDS = ("not run", "background", "run in", "run", "uses", "curl", "")


@pytest.mark.parametrize("block", ALL.values(), ids=ALL)
def test_each_block_says_what_it_is(block: Block) -> None:
    assert block.language in ("sh", "json", "python", "text", "") and block.how.split(":")[0] in KINDS, block.how
    assert block.language or "$ " not in block.text, "commands stand in blocks `sh`, so that they are run"
    reason = block.argument("not run")
    assert reason is None or len(reason) > 20, "say why"


def test_few_blocks_are_left_out() -> None:
    shell = [block for block in ALL.values() if block.language == "sh"]
    left_out = [f"{block.page.name}: {block.how}" for block in shell if block.argument("not run")]
    assert len(left_out) <= 10, left_out


def _named() -> list[str]:
    """Return the commands of ours in the running text and in all blocks."""
    found: set[str] = set()
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        lines = re.findall(r"`([^`\n]+)`", text)
        lines += [line for block in blocks(page) for line in block.text.replace("\\\n", " ").splitlines()]
        for line in lines:
            for command in re.split(r"&&|\|\||;", line.split("  #")[0]):
                words = command.strip()
                words = re.sub(r"^(\w+=\S+ )+|^\.venv/bin/|^docker compose run --rm service ", "", words)
                is_comment = words.startswith(COMMENTS)
                if words.split(" ")[0] in PROGRAMS and "..." not in words and not is_comment:
                    found.add(words)
    return sorted(found)


@pytest.mark.parametrize("text", _named())
def test_a_command_that_is_named_exists_with_its_options(text: str) -> None:
    name, *words = shlex.split(text)
    if name == "mgsr-service":
        return
    command = typer.main.get_command(app if name == "mgsr" else worker_app)
    while isinstance(command, TyperGroup) and words and not words[0].startswith("-"):
        found = command.commands.get(words[0])
        assert found is not None, f"{text}: no command {words[0]}"
        command, words = found, words[1:]
    options = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
    given = {word.split("=")[0] for word in words if word.startswith("-")}
    assert given <= options | {"--help"}, f"{text}: no option {given - options}"


@pytest.fixture
def programs(tmp_path: Path) -> dict[str, str]:
    """Return an environment in which our programs are on the path, and whose home is a scratch folder."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for name, module in PROGRAMS.items():
        (folder / name).write_text(f'#!/bin/sh\nexec "{sys.executable}" -m {module} "$@"\n')
        (folder / name).chmod(0o755)
    (folder / "python").symlink_to(sys.executable)
    kept = {key: value for key, value in os.environ.items() if not key.startswith(("MGSR_", "AWS_"))}
    path = f"{folder}{os.pathsep}{os.environ['PATH']}"
    return kept | {"PATH": path, "PYTHONPATH": str(ROOT), "HOME": str(tmp_path), "OMP_NUM_THREADS": "1"}


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("page", WITH_COMMANDS, ids=lambda page: page.name)
def test_the_commands_of_a_page(page: Path, programs: dict[str, str], tmp_path: Path) -> None:
    """Run a page's commands in one folder, in their order, with a small capture as photos/ and scene.zip."""
    if "127.0.0.1:8000" in script(page):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 8000))  # the pages' own port: nothing else may listen there
    folder = tmp_path / "work"
    photos = write_spheres(folder / "photos", size=48, train=12, test=2)
    (photos / "mesh_gt.ply").unlink()
    (folder / "scene.zip").write_bytes(zip_folder(photos))
    ran = subprocess.run(
        ["bash", "-c", script(page)], cwd=folder, env=programs, capture_output=True, text=True, timeout=1700
    )
    log = folder / "background.log"
    assert ran.returncode == 0, ran.stdout[-2000:] + ran.stderr[-2000:] + (log.read_text() if log.exists() else "")


@pytest.mark.slow
def test_the_commands_for_the_repository(programs: dict[str, str], tmp_path: Path) -> None:
    """Run the repository's commands in a copy of the sources; they leave what git tracks as it is."""
    copy = tmp_path / "repository"
    shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".git", ".venv", "build", "out"))
    for page in PAGES:
        for block in blocks(page):
            if block.argument("run in") == "repository":
                env = programs | {"PYTHONPATH": str(copy)}
                subprocess.run(["bash", "-euc", block.text], cwd=copy, env=env, check=True, timeout=300)
    for name in ("service/contract/library.json",):
        assert (copy / name).read_bytes() == (ROOT / name).read_bytes()
