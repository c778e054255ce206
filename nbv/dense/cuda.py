"""Can COLMAP's PatchMatch run on this machine?"""

from __future__ import annotations

from pathlib import Path

NVIDIA_DRIVER = Path("/dev/nvidiactl")


def patchmatch_runs() -> bool:
    """Whether there is an NVIDIA driver and the installed pycolmap has CUDA; without a driver nothing is loaded."""
    if not NVIDIA_DRIVER.exists():
        return False
    import pycolmap  # noqa: PLC0415  half a second, wasted on most machines

    return bool(pycolmap.has_cuda)
