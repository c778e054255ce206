"""``gatetune doctor``: what this machine can run."""

from __future__ import annotations

import contextlib
import importlib
import os
import shutil
import subprocess
import sys

import typer

from nbv.cache import Store
from nbv.dense import patchmatch_runs
from nbv.dense.patchmatch import cards
from tuner.commands.console import AsJson, answer_json, output, show_table, working

GIB = 2**30
WORKER_GIB = 1.5  # of memory, for a mission with photographs
_LIBRARIES = ("numpy", "torch", "botorch", "gpytorch", "optuna", "pycolmap", "open3d", "trimesh", "cv2")
_DRAW = "import pyrender; pyrender.OffscreenRenderer(16, 16).delete()"


def doctor(as_json: AsJson = False) -> None:
    """Say whether the libraries load, what renders and makes dense clouds here, and how many missions run at once.

    Example: gatetune doctor
    """
    broken, drawn = list[str](), False
    with working("loading libraries"):
        for name in _LIBRARIES:
            try:
                importlib.import_module(name)
            except Exception as error:  # a broken binary raises anything
                broken.append(f"{name} does not load: {' '.join(str(error).split())[:120]}")
        with contextlib.suppress(subprocess.TimeoutExpired):  # in a process of its own: a driver may abort it
            environment = {"PYOPENGL_PLATFORM": "egl", **os.environ}
            command = [sys.executable, "-P", "-c", _DRAW]
            drawn = not subprocess.run(command, env=environment, capture_output=True, timeout=60).returncode
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    memory_gib = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / GIB
    missions, store = max(1, min(cores, int(memory_gib / WORKER_GIB))), Store()
    free_gib = shutil.disk_usage(next(p for p in (store.root, *store.root.parents) if p.exists())).free / GIB
    patchmatch = "pycolmap" not in str(broken) and patchmatch_runs()
    facts = {
        "libraries": "; ".join(broken) or ", ".join(_LIBRARIES),
        "rendering": "raycast (the default), gl" if drawn else "raycast (the default); no OpenGL for gl",
        "dense stage": f"patchmatch on {', '.join(card.name for card in cards())}"
        if patchmatch
        else "sgbm, on the CPU",
        "machine": f"{cores} cores, {memory_gib:.1f} GiB of memory: {missions} missions at once",
        "store": f"{store.root}, pruned to {store.max_bytes / GIB:.0f} GiB as it grows; {free_gib:.1f} GiB are free",
    }
    show_table(("what", "found"), list(facts.items()))
    fit = "missions cannot be run here yet: docs/how-to/install.md" if broken else "missions can be run here"
    output.print(fit, highlight=False)
    answer_json({"fit": not broken, **facts})
    if broken:
        raise typer.Exit(1)
