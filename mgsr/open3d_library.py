"""Open3D, loaded when it is first needed: it takes seconds to import, and the trainer runs without it."""

from __future__ import annotations

import ctypes
import importlib.util
import sys
from functools import cache
from pathlib import Path
from types import ModuleType

from mgsr.errors import MgsrError


@cache
def load_open3d() -> ModuleType:
    """Import and return the module `open3d`.

    Raises MgsrError where a library that it links against is missing on this machine.
    """
    _load_libusb()
    _leave_out_plots()
    try:
        import open3d
    except ImportError as error:
        raise MgsrError(
            f"Open3D cannot be loaded ({error}); on Debian, run apt-get install libgl1 libegl1 libx11-6 libusb-1.0-0"
        ) from error
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    return open3d


def _leave_out_plots() -> None:
    """Put an empty module in the place of Open3D's plotting module, so that plotting libraries are not loaded.

    Open3D brings a web server and a plotting library along for notebooks, which take longer to load than itself.
    """
    name = "open3d.visualization.draw_plotly"
    if name not in sys.modules:
        plots = ModuleType(name, "This module is replaced; see mgsr/open3d_library.py.")
        for unused in ("get_plotly_fig", "draw_plotly", "draw_plotly_server"):
            setattr(plots, unused, None)
        sys.modules[name] = plots


def _load_libusb() -> None:
    """Load the wheel's copy of libusb where the system has none.

    Open3D links against libusb for depth cameras. Once the copy is loaded, the dynamic linker finds it by its name.
    """
    try:
        ctypes.CDLL("libusb-1.0.so.0")
    except OSError:
        spec = importlib.util.find_spec("libusb_package")
        for folder in (spec.submodule_search_locations or []) if spec else []:
            for library in Path(folder).glob("libusb-1.0.so*"):
                ctypes.CDLL(str(library))
