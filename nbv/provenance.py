"""Where a result comes from: versions, machine, revision."""

from __future__ import annotations

import functools
import platform
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any

MISSION_LIBRARIES = (
    "numpy",
    "scipy",
    "pycolmap",
    "opencv-python-headless",
    "open3d-cpu",
    "open3d",
    "pyrender2",
    "trimesh",
    "scikit-image",
    "ruckig",
)
PACKAGES = ("gatetune", *MISSION_LIBRARIES, "torch", "botorch", "gpytorch", "optuna")


@functools.cache
def versions() -> dict[str, str]:
    installed = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            installed[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return installed


@functools.cache
def git_revision() -> str:
    """The checkout's revision with ``+changes`` if the tree is dirty; ``unknown`` outside a checkout."""
    try:
        revision = _git("rev-parse", "--short=12", "HEAD")
        dirty = _git("status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return f"{revision}+changes" if dirty else revision


def provenance() -> dict[str, Any]:
    """Versions, revision and machine kind; no names or paths of the machine."""
    return {
        "versions": versions(),
        "revision": git_revision(),
        "machine": f"{platform.system()} {platform.machine()}",
    }


def _git(*arguments: str) -> str:
    root = Path(__file__).resolve().parent.parent
    command = ["git", "--no-optional-locks", *arguments]  # it may be killed, or have no room
    return subprocess.run(
        command, cwd=root, capture_output=True, text=True, timeout=10, check=True
    ).stdout.strip()
