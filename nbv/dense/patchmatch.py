"""Depth maps with COLMAP's PatchMatch stereo, where pycolmap has CUDA."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import lazy_loader
import numpy as np
from PIL import Image as PillowImage

# cv2 (through stereo) before pycolmap, which loads when it is used: the other order makes libpng crash the process.
from nbv.dense.stereo import DepthMaps, PosedViews, pixel_matrix
from nbv.errors import MissionFailure, UserError

pycolmap: Any = lazy_loader.load("pycolmap")  # half a second, wasted where no card is asked for

# The NVIDIA cards of this machine: one dense stage at a time on each, in a process of its own.
#
# COLMAP ends the process where CUDA refuses something, and a card is busy with one mission: several at once gain nothing, and
# may not fit into its memory.


DEVICES = Path("/dev")
_POLL_S = 0.2
_ON_CPU = "or go on without it: --set dense.backend=sgbm"
# What CUDA says, and what it means; the first that fits.
_REFUSALS = (
    (
        r"out of memory",
        "card_full",
        f"end what else runs on it, take smaller photographs (--set dense.max_size_px=480), {_ON_CPU}",
    ),
    (
        r"no kernel image|invalid device function|driver version|unsupported toolchain|PTX",
        "card_too_old",
        f"its driver or its generation is too old for pycolmap-cuda12: update the driver, {_ON_CPU}",
    ),
    (
        r"no CUDA-capable|No CUDA devices|num_cuda_devices|is lost|unavailable|launch failure|ECC|initialization",
        "card_lost",
        f"see whether `nvidia-smi` lists it, and repeat the command once it does, {_ON_CPU}",
    ),
)
_PATCH_MATCH = """
import json, sys
import pycolmap
options = pycolmap.PatchMatchOptions()
options.mergedict(json.loads(sys.argv[2]))
pycolmap.patch_match_stereo(sys.argv[1], options=options)
"""


def require_cuda() -> None:
    """`UserError` where the installed pycolmap has no CUDA."""
    if not pycolmap.has_cuda:
        raise UserError(
            'dense.backend=patchmatch needs a pycolmap with CUDA: run `pip install "gatetune[cuda]"` on a '
            "machine with an NVIDIA GPU, or set dense.backend=sgbm"
        )


@dataclass(frozen=True)
class Card:
    """One card, as CUDA counts them from 0, and as the driver names it."""

    index: int
    id: str

    @property
    def name(self) -> str:
        """Its model, where nvidia-smi says it."""
        known = ""
        if shutil.which("nvidia-smi"):
            command = ["nvidia-smi", "-i", self.id, "--query-gpu=name", "--format=csv,noheader"]
            with contextlib.suppress(OSError, subprocess.SubprocessError):
                answer = subprocess.run(command, capture_output=True, text=True, timeout=20)
                known = answer.stdout.strip().partition("\n")[0] if answer.returncode == 0 else ""
        return f"card {self.id}" + (f" ({known})" if known else "")


def cards() -> list[Card]:
    """Those that this process may use."""
    chosen = os.environ.get("CUDA_VISIBLE_DEVICES")
    if chosen is None:
        numbers = (re.fullmatch(r"nvidia(\d+)", path.name) for path in DEVICES.glob("nvidia*"))
        ids = list(map(str, sorted(int(number[1]) for number in numbers if number)))
    else:
        ids = [card for name in chosen.split(",") if (card := name.strip())]
    return [Card(index, card) for index, card in enumerate(ids)]


@contextlib.contextmanager
def free_card() -> Iterator[Card]:
    """A card that no other mission of this user uses on this machine until the ``with`` ends; waits for one.

    `MissionFailure` where there is no card.
    """
    present = cards()
    if not present:
        raise MissionFailure("machine_error: card_lost", f"there is no NVIDIA card; {_REFUSALS[-1][2]}")
    with contextlib.ExitStack() as stack:
        folder = Path(tempfile.gettempdir())
        locks = [
            stack.enter_context((folder / f"gatetune-{os.getuid()}-card-{card.id}.lock").open("ab"))
            for card in present
        ]
        while True:
            for card, lock in zip(present, locks, strict=True):
                with contextlib.suppress(BlockingIOError):
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    yield card
                    return
            time.sleep(_POLL_S)


def patch_match(workspace: Path, options: Mapping[str, Any], card: Card) -> None:
    """COLMAP's PatchMatch on a workspace; `MissionFailure`, which names the card and the remedy, where CUDA refuses."""
    chosen = json.dumps({**options, "gpu_index": str(card.index)})
    # Numbered as the driver numbers them, and not the fastest first.
    ran = subprocess.run(
        [sys.executable, "-P", "-c", _PATCH_MATCH, str(workspace), chosen],
        env={**os.environ, "CUDA_DEVICE_ORDER": "PCI_BUS_ID"},
        capture_output=True,
        text=True,
        errors="replace",
    )
    if ran.returncode:
        raise refusal(card.name, ran.stderr, ran.returncode)


def refusal(name: str, output: str, status: int) -> MissionFailure:
    """What COLMAP's last words mean for the card called ``name``."""
    lines = re.findall(r"\[\w+\.\w+:\d+\] (.+)|CUDA error[^\n]* - (.+)|^(\w*Error: .+)", output, re.MULTILINE)
    words = next((" ".join(filter(None, line)) for line in reversed(lines)), f"it ended with status {status}")
    unknown = ("card_failed", f"see what `nvidia-smi` says of it, {_ON_CPU}")
    meant = (row[1:] for row in _REFUSALS if re.search(row[0], output, re.IGNORECASE))
    reason, remedy = next(meant, unknown)
    return MissionFailure(f"machine_error: {reason}", f"{name} refused PatchMatch: {words.strip()}; {remedy}")


_MIN_DEPTH_M = 0.3


def patchmatch_depth_maps(views: PosedViews) -> DepthMaps:
    """The dense backend ``patchmatch``: COLMAP's own stage of the paper; our consistency check and fusion follow.

    Every view is matched with ``patchmatch_sources`` others. Depths are sought within ``crop_half_width_m`` of the target, as in
    SGBM without ``surface_m``. Not bit-reproducible: COLMAP seeds its CUDA random numbers itself.

    `UserError` where the installed pycolmap has no CUDA; `MissionFailure` where the card fails.
    """
    require_cuda()
    config = views.config
    # PatchMatch weighs many sources per pixel, so it is given more than the pairwise matcher.
    wide = replace(views, config=replace(config, neighbours=config.patchmatch_sources))
    sources = {name: chosen for name in sorted(views.images) if (chosen := wide.neighbours[name])}
    if not sources:
        return {}
    distances = [float(np.linalg.norm(views.center_m(name) - views.target)) for name in sources]
    options = {
        "depth_min": max(_MIN_DEPTH_M, min(distances) - config.crop_half_width_m),
        "depth_max": max(distances) + config.crop_half_width_m,
        "window_radius": config.patchmatch_window_radius_px,
        "window_step": config.patchmatch_window_step_px,
        "num_samples": config.patchmatch_draws,
        "num_iterations": config.patchmatch_iterations,
        "geom_consistency": False,  # a second pass, which loses points: docs/results/index.md
        # Ours follows. COLMAP's wants two sources to confirm a depth, and a photograph of a small set has two to four.
        "filter": False,
    }
    with tempfile.TemporaryDirectory(prefix="gatetune-patchmatch-") as folder:
        workspace = Path(folder)
        write_workspace(workspace, views)
        lines = [
            line for name in sources for line in (file_name(name), ", ".join(map(file_name, sources[name])))
        ]
        (workspace / "stereo" / "patch-match.cfg").write_text("\n".join(lines) + "\n")
        with free_card() as card:
            patch_match(workspace, options, card)
        return read_depth_maps(workspace, list(sources))


def write_workspace(workspace: Path, views: PosedViews) -> None:
    """Write photographs and their poses as COLMAP's dense workspace: ``images/``, ``sparse/`` (binary) and ``stereo/``.

    COLMAP's stereo reads pixel centres at integers, so the principal point is written half a pixel off the sparse
    convention.
    """
    results = (f"stereo/{name}" for name in ("depth_maps", "normal_maps", "consistency_graphs"))
    for folder in ("images", "sparse", *results):
        (workspace / folder).mkdir(parents=True)
    matrix = pixel_matrix(views.camera)
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(
            camera_id=1,
            model="PINHOLE",
            width=views.camera.width_px,
            height=views.camera.height_px,
            params=[matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]],
        )
    )
    for image_id, name in enumerate(sorted(views.images), start=1):
        PillowImage.fromarray(views.images[name]).save(workspace / "images" / file_name(name))
        model.add_image_with_trivial_frame(
            pycolmap.Image(name=file_name(name), keypoints=np.zeros((0, 2)), camera_id=1, image_id=image_id),
            pycolmap.Rigid3d(np.asarray(views.camera_from_world[name], dtype=float)[:3]),
        )
    model.write(workspace / "sparse")


def read_depth_maps(workspace: Path, names: Sequence[str]) -> DepthMaps:
    """COLMAP's depths (H, W) in metres by view; NaN where it has none. Views without a file are left out."""
    maps = {}
    for name in sorted(names):
        file = workspace / "stereo" / "depth_maps" / f"{file_name(name)}.photometric.bin"
        if file.is_file():
            depth_map = pycolmap.DepthMap()
            depth_map.read(file)
            depth_m = np.array(depth_map.to_array(), dtype=np.float32)
            maps[name] = np.where(depth_m > 0, depth_m, np.float32(np.nan))
    return maps


def file_name(view: str) -> str:
    """Image file name of a view; COLMAP wants a suffix."""
    return view if view.lower().endswith((".png", ".jpg", ".jpeg")) else f"{view}.png"
