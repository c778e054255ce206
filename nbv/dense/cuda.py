"""Can COLMAP's PatchMatch run on this machine?"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

NVIDIA_DRIVER = Path("/dev/nvidiactl")


def patchmatch_runs() -> bool:
    """Whether there is an NVIDIA driver and the installed pycolmap has CUDA; without a driver nothing is loaded."""
    if not NVIDIA_DRIVER.exists():
        return False
    import pycolmap  # noqa: PLC0415  half a second, wasted on most machines

    return bool(pycolmap.has_cuda)


def best_dense_stage(values: Mapping[str, Any]) -> dict[str, Any]:
    """``values`` by parameter path with COLMAP's PatchMatch, the paper's, where it runs here and they name no other.

    It becomes part of the configuration, so that a result says what made it, and a resume elsewhere uses the same.
    """
    if "dense.backend" in values or not patchmatch_runs():
        return dict(values)
    return {**values, "dense.backend": "patchmatch"}
