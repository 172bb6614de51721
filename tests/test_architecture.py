"""The layers of docs/architecture.md, held by reading the imports; and what `import mgsr` needs."""

from __future__ import annotations

import ast
import graphlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

# A part imports from rows below its own, and from itself. The same table stands in docs/architecture.md.
LAYERS = (
    ("checks", "config", "errors", "open3d_library", "parallel"),
    ("native",),
    ("data",),
    ("geometry", "inspection"),
    ("shading", "stereo"),
    ("start", "ops"),
    ("gaussians",),
    ("renderers",),
    ("densify", "losses", "metrics"),
    ("training", "mesh", "export", "report"),
    ("bench", "budget", "segmentation"),
    ("pipeline",),
    ("cli",),
    ("service",),
    ("worker",),
    ("program",),
)
# Parts of one row that may look at a neighbour, and why it is no cycle.
NEIGHBOURS = {("errors", "checks"), ("errors", "config"), ("errors", "open3d_library")}
OUTSIDE = {"redis", "rq", "obstore", "fastapi", "uvicorn", "httpx", "service", "worker", "program"}
BESIDE = ("service", "worker", "program")


def rank(part: str) -> int:
    return next(row for row, parts in enumerate(LAYERS) if part in parts)


def sources(folder: str) -> list[Path]:
    return sorted((ROOT / folder).rglob("*.py"))


def part_of(path: Path) -> str:
    """Return the part that a file belongs to.

    mgsr/data/scene.py is `data`, mgsr/config/train.py is `config`, worker/cli.py is `worker`.
    """
    names = path.relative_to(ROOT).with_suffix("").parts
    return names[1] if names[0] == "mgsr" else names[0]


def imports(path: Path) -> Iterator[str]:
    """Yield full dotted names, also those inside functions: late imports follow the layers too."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            assert node.level == 0, f"{path}: relative import"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


ALL = [path for folder in ("mgsr", *BESIDE) for path in sources(folder)]


@pytest.mark.parametrize("path", ALL, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_row_imports_only_rows_below_it(path: Path) -> None:
    own = part_of(path)
    for name in imports(path):
        names = name.split(".")
        if names[0] not in ("mgsr", *BESIDE) or name == "mgsr" or own == "__init__":
            continue
        other = names[1] if names[0] == "mgsr" else names[0]
        if other == "__version__" or other == own or (other, own) in NEIGHBOURS:
            continue
        assert rank(other) < rank(own), f"{path.name} ({own}) imports {name} ({other}), which is not below it"


@pytest.mark.parametrize("path", sources("mgsr"), ids=lambda path: str(path.relative_to(ROOT)))
def test_the_library_knows_nothing_of_jobs(path: Path) -> None:
    assert not {name.split(".")[0] for name in imports(path)} & OUTSIDE


@pytest.mark.parametrize("path", sources("service"), ids=lambda path: str(path.relative_to(ROOT)))
def test_the_service_knows_nothing_of_the_library(path: Path) -> None:
    """Check that the service enqueues by dotted name, and starts the worker as a program."""
    assert not {name.split(".")[0] for name in imports(path)} & {"mgsr", "torch", "numpy", "worker", "program"}


@pytest.mark.parametrize("path", sources("service/contract"), ids=lambda path: str(path.relative_to(ROOT)))
def test_the_contract_knows_nothing_of_http(path: Path) -> None:
    names = list(imports(path))
    assert not {name.split(".")[0] for name in names} & {"fastapi", "starlette", "uvicorn", "httpx"}
    assert all(name.startswith("service.contract.") for name in names if name.startswith("service"))


@pytest.mark.parametrize("path", sources("worker"), ids=lambda path: str(path.relative_to(ROOT)))
def test_the_worker_shares_only_the_contract_with_the_service(path: Path) -> None:
    used = {name for name in imports(path) if name.split(".")[0] == "service"}
    assert all(name.startswith("service.contract") for name in used), used


@pytest.mark.parametrize("path", sources("worker"), ids=lambda path: str(path.relative_to(ROOT)))
def test_the_worker_knows_nothing_of_the_command_line(path: Path) -> None:
    assert not [name for name in imports(path) if name.startswith("mgsr.cli")]


def imported_at_once(path: Path) -> set[str]:
    """Return the modules of mgsr that a file imports while it is being imported, or for its annotations alone."""
    found: set[str] = set()
    blocks = [ast.parse(path.read_text(encoding="utf-8")).body]
    for node in (node for block in blocks for node in block):
        if isinstance(node, ast.If | ast.Try):
            blocks.append([*node.body, *node.orelse])
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            modules = {f"{node.module}.{alias.name}" for alias in node.names} & MODULES.keys()
            found |= modules or {node.module} & MODULES.keys()
    return found


MODULES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for path in sources("mgsr")
    if path != ROOT / "mgsr/__init__.py"
}


def test_no_modules_import_each_other() -> None:
    """Check that modules import each other in no circle, however long, not even for their annotations."""
    graph = {name: imported_at_once(path) for name, path in MODULES.items()}
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        pytest.fail(f"imports in a circle: {' <- '.join(error.args[1])}")


def test_every_part_has_its_row() -> None:
    parts = {part_of(path) for path in sources("mgsr") if path != ROOT / "mgsr/__init__.py"}
    assert parts <= {part for row in LAYERS for part in row}


def test_the_table_is_the_documents() -> None:
    text = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    table = text.split("```")[1].strip().splitlines()
    rows = [tuple(line.split(maxsplit=1)[1].split()) for line in reversed(table) if line[0].isdigit()]
    assert rows == list(LAYERS)


def test_oracles_share_no_code_with_the_library() -> None:
    """Check that oracles share no code with the library; the camera class is plain data and may be used."""
    for path in sources("tests/oracles"):
        used = {name for name in imports(path) if name.startswith("mgsr")}
        assert all(name.startswith("mgsr.data.camera") for name in used), f"{path.name} imports {used}"


def test_the_maths_headers_stand_alone() -> None:
    for path in sorted((ROOT / "mgsr/native/math").glob("*.h")):
        included = [line for line in path.read_text().splitlines() if line.startswith("#include")]
        banned = ("cuda", "torch", "nanobind", "bindings/", "kernels/")
        assert not [line for line in included if any(word in line for word in banned)], path.name


BLOCKER = """
import sys
allowed = {"mgsr"} | set(sys.stdlib_module_names)
class Block:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] not in allowed:
            raise ImportError(f"{name} is not needed for this")
sys.meta_path.insert(0, Block())
import mgsr
"""


def test_importing_mgsr_needs_no_package() -> None:
    subprocess.run([sys.executable, "-c", BLOCKER], check=True, cwd=ROOT, timeout=120)


def test_the_trainer_loads_without_the_heavy_packages() -> None:
    names = ("open3d", "OpenImageIO", "trimesh", "skimage", "plyfile", "rich", "typer")
    code = f"import sys\nfor name in {names}: sys.modules[name] = None\nimport mgsr.training.run"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT, timeout=120)


# The service describes what it shares with the library by its own classes, since it does not import the library.
IN_THE_SERVICE_TOO = {"CurvePoint", "Device"}


def test_a_class_name_means_one_thing() -> None:
    places: dict[str, list[str]] = {}
    for path in ALL:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name, []).append(f"{path.relative_to(ROOT)}:{node.lineno}")
    twice = {name: found for name, found in places.items() if len(found) > 1}
    assert twice.keys() == IN_THE_SERVICE_TOO, twice
