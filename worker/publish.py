"""Upload an attempt's results to the store, and describe them."""

from __future__ import annotations

import hashlib
import json
import mimetypes
from pathlib import Path
from typing import Any

from service.contract.jobs import attempt_path
from service.contract.records import Artifact
from service.contract.store import Store

# Files in the folder of results that are not published.
_KEPT_BACK = {"checkpoint"}
_TYPES = {
    ".ply": "application/octet-stream",
    ".glb": "model/gltf-binary",
    ".usdz": "model/vnd.usdz+zip",
    ".exr": "image/x-exr",
    ".obj": "model/obj",
    ".txt": "text/plain; charset=utf-8",
}
_ESTIMATE = "estimate.json"
_METRICS = ("psnr_test", "ssim_test", "mesh", "gaussians", "iterations", "seconds", "peak_memory_mib", "gt")


def upload_results(store: Store, job: str, attempt: int, out: Path) -> list[Artifact]:
    """Upload every result file under the attempt, and return the artifacts. Raises StoreError."""
    artifacts = []
    for path in sorted(out.rglob("*")):
        name = path.relative_to(out).as_posix()
        if path.is_file() and name not in _KEPT_BACK:
            store.upload(attempt_path(job, attempt, name), path)
            size = path.stat().st_size
            artifacts.append(Artifact(name=name, size=size, sha256=_sha256(path), content_type=media_type(name)))
    return artifacts


def headline(out: Path) -> dict[str, Any]:
    """Return the main figures and the notes of report.json for the job's outcome.

    For a dry run, return the estimate of each preset.
    """
    if (out / _ESTIMATE).is_file():
        return {"estimate": json.loads((out / _ESTIMATE).read_text())["presets"]}
    report = json.loads((out / "report.json").read_text())
    figures = {name: report[name] for name in _METRICS if report.get(name) is not None}
    notes = report.get("input", {}).get("notes")
    return figures | ({"notes": notes} if notes else {})


def findings(out: Path) -> list[dict[str, Any]] | None:
    """Return the findings of the check before training, or None without a check."""
    document = _ESTIMATE if (out / _ESTIMATE).is_file() else "report.json"
    inspection = json.loads((out / document).read_text()).get("inspection")
    return None if inspection is None else list(inspection["findings"])


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def media_type(name: str) -> str:
    """Return the media type of a result file, given its name."""
    return _TYPES.get(Path(name).suffix) or mimetypes.guess_type(name)[0] or "application/octet-stream"
