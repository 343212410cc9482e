"""Starting sooner: filterpy's Kalman filter without the rest of filterpy.

Importing anything of filterpy imports all of it, and with it scipy.stats, scipy.ndimage and more: most of
the time that the daemon takes to start, and a third of its memory. The one class that flies needs none of
that. Its file is loaded as it is, in packages that contain what it asks for and nothing else.
"""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

PACKAGES = ("filterpy", "filterpy.common", "filterpy.kalman", "filterpy.stats")


def load_kalman_filter_alone() -> None:
    """Let `from filterpy.kalman import KalmanFilter` load the file of that class and no more.

    For programs that need nothing else of filterpy. Does nothing if filterpy has been imported.
    """
    spec = find_spec("filterpy")
    if "filterpy" in sys.modules or spec is None or not spec.submodule_search_locations:
        return
    root = Path(spec.submodule_search_locations[0]).parent
    packages = {name: _bare_package(name, root) for name in PACKAGES}
    helpers = import_module("filterpy.common.helpers")
    _fill(packages["filterpy.common"], pretty_str=helpers.pretty_str, reshape_z=helpers.reshape_z)
    _fill(packages["filterpy.stats"], logpdf=_logpdf)
    module = import_module("filterpy.kalman.kalman_filter")
    _fill(packages["filterpy.kalman"], KalmanFilter=module.KalmanFilter)


def _bare_package(name: str, root: Path) -> ModuleType:
    """A package that finds its modules in its own directory, and whose __init__ was not run."""
    package = ModuleType(name)
    package.__path__ = [str(root.joinpath(*name.split(".")))]
    sys.modules[name] = package
    return package


def _fill(package: ModuleType, **contents: Any) -> None:
    for name, value in contents.items():
        setattr(package, name, value)


def _logpdf(*arguments: Any, **options: Any) -> Any:
    """filterpy's own, loaded when somebody asks for a likelihood; the daemon never does."""
    return import_module("filterpy.stats.stats").logpdf(*arguments, **options)
