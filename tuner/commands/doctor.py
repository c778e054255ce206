"""``gatetune doctor``: whether missions can run on this machine, and if not, which command helps."""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import importlib.metadata
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Literal, NamedTuple

import typer

from nbv.cache import Store
from nbv.dense.card import cards
from nbv.dense.reconstruct import NVIDIA_DRIVER
from tuner.commands.console import AsJson, answer_json, output, working

GIB = 2**30
WORKER_GIB = 1.5  # of memory, for a mission with photographs
MIN_FREE_GIB = 5.0
_LIBRARIES = ("numpy", "torch", "botorch", "gpytorch", "optuna", "pycolmap", "open3d", "trimesh", "cv2")
_SYSTEM = {
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libX11.so.6": "libx11-6",
    "libudev.so.1": "libudev1",
    "libidn2.so.0": "libidn2-0",
    "libgomp.so.1": "libgomp1",
}
_CARD = "docs/how-to/install.md says how a machine with a card is set up"
_CUDA_BUILD = "pycolmap-cuda12"  # loads these, too
_SYSTEM_CUDA = {
    "libSM.so.6": "libsm6",
    "libICE.so.6": "libice6",
    "libXext.so.6": "libxext6",
    "libuuid.so.1": "libuuid1",
}


class Finding(NamedTuple):
    verdict: Literal["ok", "note", "bad"]  # bad: missions cannot be run
    what: str
    remedy: str = ""  # what it means, or the command that helps


def doctor(as_json: AsJson = False) -> None:
    """Check libraries, OpenGL, CUDA, cores, memory, disk and store; print what each finding means.

    Example: gatetune doctor
    """
    marks = {"ok": "[green]ok  [/]", "note": "[yellow]note[/]", "bad": "[red]BAD [/]"}
    findings = []
    for check in (_libraries, _graphics, _machine, _disk):
        with working(f"checking {check.__name__[1:]}"):
            results = list(check())
        findings += results
        for finding in results:
            output.print(marks[finding.verdict], end=" ", markup=True)
            output.print(finding.what, highlight=False, soft_wrap=True)
            if finding.remedy:
                output.print(f"       {finding.remedy}", highlight=False, soft_wrap=True)
    fit = all(finding.verdict != "bad" for finding in findings)
    output.print("missions can be run here" if fit else "missions cannot be run here yet")
    answer_json({"fit": fit, "findings": [finding._asdict() for finding in findings]})
    if not fit:
        raise typer.Exit(1)


def _libraries() -> Iterator[Finding]:
    """Whether the libraries load, and what Open3D and OpenGL load and pip cannot bring."""
    missing = {}
    with contextlib.suppress(importlib.metadata.PackageNotFoundError):
        importlib.metadata.version(_CUDA_BUILD)
        missing = _missing(_SYSTEM_CUDA)
    missing |= _missing(_SYSTEM)
    if missing:
        named = ", ".join(f"{library} ({package})" for library, package in missing.items())
        install = f"apt-get update && apt-get install -y {' '.join(missing.values())}   (as root)"
        yield Finding("bad", f"system libraries are missing: {named}", install)
    broken = False
    for name in _LIBRARIES:
        try:
            importlib.import_module(name)
        except Exception as error:  # a broken binary raises anything
            broken, first = True, " ".join(str(error).split())[:120]
            yield Finding("bad", f"{name} does not load: {first}", "" if missing else "make setup")
    if not missing and not broken:
        yield Finding("ok", f"system libraries, {', '.join(_LIBRARIES)}")


def _missing(needed: dict[str, str]) -> dict[str, str]:
    """Return the libraries that do not load, with their Debian packages."""
    missing = {}
    for library, package in needed.items() if sys.platform == "linux" else ():
        try:
            ctypes.CDLL(library)
        except OSError:
            missing[library] = package
    return missing


def _graphics() -> Iterator[Finding]:
    """Whether the renderer ``gl`` (``raycast`` always can) and COLMAP's PatchMatch can run."""
    code = "import pyrender; pyrender.OffscreenRenderer(16, 16).delete()"
    environment = {"PYOPENGL_PLATFORM": "egl", **os.environ}
    try:  # in a process of its own: a driver may abort it
        tried = subprocess.run(
            [sys.executable, "-P", "-c", code], env=environment, capture_output=True, text=True, timeout=60
        )
        works, said = tried.returncode == 0, (tried.stderr.strip().splitlines() or ["no message"])[-1]
    except subprocess.TimeoutExpired:
        works, said = False, "no answer in 60 s"
    if works:
        yield Finding("ok", "OpenGL: scene.backend=gl can run")
    else:
        yield Finding(
            "note",
            f"no OpenGL: scene.backend=gl cannot run, raycast (the default) can ({said[:120]})",
            "apt-get install -y libegl1 libgl1 libgl1-mesa-dri   (as root), or PYOPENGL_PLATFORM=osmesa",
        )
    try:
        import pycolmap
    except Exception:  # `_libraries` has said so
        return
    nvidia_cards, driver = cards(), NVIDIA_DRIVER.exists()
    if pycolmap.has_cuda and driver and nvidia_cards:
        names = ", ".join(card.name for card in nvidia_cards)
        yield Finding("ok", f"COLMAP with CUDA on {names}: dense.backend=patchmatch is the default")
    elif pycolmap.has_cuda:
        lacking = "no NVIDIA card" if driver else f"no NVIDIA driver ({NVIDIA_DRIVER})"
        yield Finding("note", f"COLMAP with CUDA, but {lacking}: the dense stage is sgbm, on the CPU", _CARD)
    else:
        without = "COLMAP without CUDA: the dense stage is sgbm, on the CPU"
        yield Finding("note", without, f'with an NVIDIA GPU: pip install "gatetune[cuda]"; {_CARD}')


def _machine() -> Iterator[Finding]:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    memory_gib = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / GIB
    summary, fitting = f"{cores} cores, {memory_gib:.1f} GiB of memory", max(1, int(memory_gib / WORKER_GIB))
    if memory_gib < WORKER_GIB:
        yield Finding("bad", summary, f"a mission needs up to {WORKER_GIB} GiB")
    elif fitting < cores:
        yield Finding("note", summary, f"memory for {fitting} missions: --workers {fitting}")
    else:
        yield Finding("ok", f"{summary}: {cores} missions in parallel")


def _disk() -> Iterator[Finding]:
    """Room for runs and for the store, and whether both can be written."""
    store = Store()
    for what, folder in (("runs", Path.cwd()), ("store", store.root)):
        existing = next(path for path in (folder, *folder.parents) if path.exists())
        free_gib = shutil.disk_usage(existing).free / GIB
        disk = f"{what}: {existing}, {free_gib:.1f} GiB free"
        if not os.access(existing, os.W_OK):
            yield Finding("bad", f"{disk}, cannot be written", "choose another folder, or set GATETUNE_HOME")
        elif free_gib < MIN_FREE_GIB:
            yield Finding("note", disk, "gatetune cache prune --max-gib 2 makes room")
        else:
            yield Finding("ok", disk)
    used_gib = sum(kind.size_bytes for kind in store.info()) / GIB
    yield Finding("ok", f"store holds {used_gib:.1f} GiB and is pruned at {store.max_bytes / GIB:.0f} GiB")
