"""Detect cameras in formats that MGSR does not read, by file names, and tell how to convert them.

To add a program, add a row to the table.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from fnmatch import translate
from functools import cached_property
from pathlib import Path

# The most file names that are examined, and the most bytes of a file.
_MOST_NAMES = 20_000
_HEAD = 1 << 20

_PLAIN = "write its cameras to transforms.json or in MGSR's plain form (docs/inputs.md)"
_EXPORT_XML = (
    "open it in Metashape and write an XML file beside the photographs with File, Export, Export Cameras (Agisoft XML)"
)
_CONVERT_IN_MESHROOM = "convert it with Meshroom's node ConvertSfMFormat, with sfm as the format"
_EXPORT_NERFSTUDIO = "convert it with `ns-process-data {} --data CAPTURE --output-dir SCENE` (nerfstudio)"


@dataclass(frozen=True)
class _Unread:
    """A program whose cameras MGSR does not read.

    files: patterns of the program's files, relative to the capture's folder. All must exist; the message names the
    first. contains: text that the beginning of the first file must contain, if its name is ambiguous. cure: the
    remedy.
    """

    program: str
    files: tuple[str, ...]
    cure: str
    contains: bytes = b""

    @cached_property
    def patterns(self) -> list[re.Pattern[str]]:
        """Return the compiled patterns, in which * does not match a slash."""
        texts = (translate(pattern.lower()).replace(".*", "[^/]*") for pattern in self.files)
        return [re.compile(text) for text in texts]

    def found_in(self, folder: Path, names: list[str]) -> str | None:
        """Return the name of the first file if all files are among the `names` of a folder, else None."""
        first, *others = ([name for name in names if pattern.match(name.lower())] for pattern in self.patterns)
        if not first or not all(others):
            return None
        if self.contains and self.contains.lower() not in _head(folder / first[0]):
            return None
        return first[0]


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(_HEAD).lower()
    except OSError:
        return b""


_TABLE = (
    # Phones and tablets
    _Unread("Stray Scanner", ("odometry.csv", "camera_matrix.csv"), f"extract the frames of rgb.mp4 and {_PLAIN}"),
    _Unread("3D Scanner App", ("frame_[0-9]*.json", "info.json"), _PLAIN, b"cameraPoseARFrame"),
    _Unread("3D Scanner App", ("frame_[0-9]*.json", "frame_[0-9]*.jpg"), _PLAIN, b"cameraPoseARFrame"),
    _Unread("ARKitScenes", ("lowres_wide.traj",), _PLAIN),
    _Unread("ARKitScenes", ("*_frames/lowres_wide.traj",), _PLAIN),
    _Unread("Spectacular AI", ("data.jsonl", "calibration.json"), "convert it with `sai-cli process CAPTURE SCENE`"),
    _Unread("Project Aria", ("*.vrs",), _EXPORT_NERFSTUDIO.format("aria")),
    _Unread("ScanNet++", ("pose_intrinsic_imu.json",), "use its dslr/ folder, or iphone/colmap with the photographs"),
    _Unread("Record3D", ("*.r3d",), "unpack the file, which is a zip archive, and use the folder"),
    # Photogrammetry
    _Unread("Metashape", ("*.psx",), _EXPORT_XML),
    _Unread("Metashape", ("*.psz",), _EXPORT_XML),
    _Unread("Metashape", ("*.files/project.zip",), _EXPORT_XML),
    _Unread(
        "RealityCapture",
        ("*.rcproj",),
        "open it and write a .csv file beside the photographs with Alignment, Export, Registration, "
        '"Internal/External camera parameters"',
    ),
    _Unread("Pix4D", ("*.p4d",), "copy ..._calibrated_camera_parameters.txt from its params folder to the photographs"),
    _Unread("PhotoModeler", ("*.pmr*",), _PLAIN),
    _Unread(
        "OpenMVG",
        ("sfm_data.bin",),
        "convert it with `openMVG_main_ConvertSfM_DataFormat -i sfm_data.bin -o sfm_data.json`",
    ),
    _Unread("Meshroom", ("sfm.abc",), _CONVERT_IN_MESHROOM),
    _Unread("Meshroom", ("*.abc",), _CONVERT_IN_MESHROOM, b"mvg_intrinsicType"),
    _Unread("OpenMVS", ("*.mvs",), "convert it with `InterfaceCOLMAP -i SCENE.mvs -o FOLDER` (OpenMVS)"),
    _Unread("MVE", ("views/*.mve",), "use the structure-from-motion model behind it, or " + _PLAIN),
    _Unread("MVE", ("*.mve/meta.ini",), "use the structure-from-motion model behind it, or " + _PLAIN),
    _Unread("PMVS", ("txt/[0-9]*.txt",), "use the bundle.rd.out behind it, or " + _PLAIN, b"CONTOUR"),
    _Unread(
        "COLMAP, without poses",
        ("*.db",),
        "run its mapper, or give the photographs without this file: their cameras are then found",
        b"CREATE TABLE cameras",
    ),
    # Research
    _Unread(
        "ScanNet",
        ("*.sens",),
        "export it with ScanNet's SensReader (`reader.py --filename FILE.sens --output_path SCENE "
        "--export_color_images --export_poses --export_intrinsics`)",
    ),
    _Unread("SDFStudio", ("meta_data.json",), _PLAIN, b"camtoworld"),
    _Unread("NeRO", ("cache.pkl", "images/*"), "use the COLMAP model behind it"),
    _Unread("Nerfies or HyperNeRF", ("camera/*.json", "dataset.json"), _PLAIN),
    _Unread("CO3D", ("frame_annotations.jgz",), _PLAIN),
    _Unread("MegaDepth", ("imgs/*", "depths/*.h5"), "use its COLMAP model of MegaDepth_v1_SfM and the photographs"),
    _Unread("DTU", ("pos_[0-9]*.txt",), "use the scene in NeuS's or MVSNet's form, or " + _PLAIN),
    _Unread("DTU", ("cal18/pos_[0-9]*.txt",), "use the scene in NeuS's or MVSNet's form, or " + _PLAIN),
    _Unread("Strecha's benchmark", ("*.jpg.camera",), _PLAIN),
    _Unread("TUM RGB-D", ("groundtruth.txt", "rgb.txt"), "match photographs and poses by time, and " + _PLAIN),
    _Unread("7-Scenes", ("frame-[0-9]*.pose.txt",), _PLAIN),
    _Unread("Replica", ("traj.txt",), _PLAIN),
    _Unread("KITTI", ("poses.txt", "calib.txt"), _PLAIN),
    _Unread("KITTI", ("calib.txt", "image_[0-9]/*"), _PLAIN),
    _Unread("EuRoC", ("mav0/cam[0-9]",), _PLAIN),
    _Unread("MonST3R", ("pred_traj.txt",), _PLAIN),
    # Scenes of other programs, whose files may also hold cameras
    _Unread("Blender", ("*.blend",), "export them with its add-on BlenderNeRF, as transforms_train.json"),
    _Unread("Mitsuba", ("*.xml",), _PLAIN, b"<scene version"),
    _Unread(
        "an Alembic file", ("*.abc",), "export them from its program as COLMAP, Bundler or Metashape's XML", b"camera"
    ),
    _Unread(
        "an FBX file", ("*.fbx",), "export them from its program as COLMAP, Bundler or Metashape's XML", b"FocalLength"
    ),
    _Unread("a USD file", ("*.usd*",), "export them from its program as COLMAP, Bundler or Metashape's XML", b"Camera"),
    _Unread("Nuke", ("*.chan",), _PLAIN),
)


def unread_cameras(root: Path) -> str | None:
    """Return a message on cameras of other programs in a folder or its subfolders, or None if there are none.

    It reads "the cameras are of PROGRAM (FILE), which MGSR does not read; CURE".
    """
    for folder in [root, *_folders(root)]:
        names = _names(folder)
        for program in _TABLE:
            if name := program.found_in(folder, names):
                file = (folder / name).relative_to(root)
                return f"the cameras are of {program.program} ({file}), which MGSR does not read; {program.cure}"
    return None


def _names(folder: Path) -> list[str]:
    """Return the sorted relative paths of the files and folders in a folder and its subfolders."""
    names: list[str] = []
    for path in [folder, *_folders(folder)]:
        names += [inner.relative_to(folder).as_posix() for inner in _listed(path)[: _MOST_NAMES - len(names)]]
    return sorted(names)


def _folders(folder: Path) -> list[Path]:
    return [path for path in _listed(folder) if path.is_dir()]


def _listed(folder: Path) -> list[Path]:
    """Return a folder's content without hidden files, at most _MOST_NAMES; empty if it can't be read."""
    try:
        paths = sorted(folder.iterdir())
    except OSError:
        return []
    return [path for path in paths if not path.name.startswith((".", "__"))][:_MOST_NAMES]
