"""Depth maps with COLMAP's PatchMatch stereo, where pycolmap has CUDA."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

# isort: off
# cv2 (through views) before pycolmap: the other order makes libpng crash the process.
from nbv.dense.views import DepthMaps, PosedViews, pixel_matrix
import pycolmap
# isort: on

import numpy as np
from PIL import Image as PillowImage

from nbv.dense.card import free_card, patch_match, require_cuda

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
    for folder in (
        "images",
        "sparse",
        *(f"stereo/{n}" for n in ("depth_maps", "normal_maps", "consistency_graphs")),
    ):
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
