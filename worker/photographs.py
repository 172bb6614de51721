"""The photographs of a run for display: sheets of small pictures, and the cameras."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np

from mgsr.data.scene import Scene, View
from mgsr.inspection.findings import Inspection
from mgsr.inspection.inspect import photo_names
from mgsr.report.contact_sheet import TILE, columns, contact_sheet
from mgsr.report.encode import webp
from mgsr.report.pictures import mask_picture
from service.contract.photographs import CheckedPhotograph, CheckedPhotographs

FILE = "photographs.json"


class PhotographFiles:
    """A writer of photographs.json, photographs.webp and masks.webp, each atomically, into a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._inspection: Inspection | None = None

    def checked(self, inspection: Inspection, scene: Scene) -> None:
        """Write the checked photographs, and their masks if they have any."""
        self._inspection = inspection
        self._write_sheet("photographs", scene, lambda view: view.image)
        self.masked(scene)

    def masked(self, scene: Scene) -> None:
        """Write the photographs' masks and the reconstructed region. Without a check, write nothing."""
        if self._inspection is None:
            return
        if scene.masked:
            self._write_sheet("masks", scene, _masked)
        x, y, z = scene.user_from_scene.to_user(np.zeros(3)).tolist()
        content = CheckedPhotographs(
            tile=TILE,
            columns=columns(len(self._inspection.photographs)),
            masks=scene.masked,
            middle=(x, y, z),
            radius=scene.user_from_scene.scale,
            photographs=[CheckedPhotograph(**asdict(photo)) for photo in self._inspection.photographs],
        )
        self._write(FILE, content.model_dump_json().encode())

    def _write_sheet(self, name: str, scene: Scene, picture: Callable[[View], np.ndarray | None]) -> None:
        assert self._inspection is not None
        views = dict(zip(photo_names(scene), [*scene.train, *scene.test], strict=True))
        wanted = [views.get(photo.name) for photo in self._inspection.photographs]
        pictures = (None if view is None else picture(view) for view in wanted)
        self._write(f"{name}.webp", webp(contact_sheet(pictures, len(wanted))))

    def _write(self, name: str, data: bytes) -> None:
        self._folder.mkdir(exist_ok=True)
        partial = self._folder / f".{name}"
        partial.write_bytes(data)
        os.replace(partial, self._folder / name)


def _masked(view: View) -> np.ndarray | None:
    return None if view.alpha is None else mask_picture(view.image, view.alpha)
