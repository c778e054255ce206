"""Depth maps with COLMAP's PatchMatch stereo, where pycolmap has CUDA."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

# isort: off
# cv2 (through stereo) before pycolmap: the other order makes libpng crash the process.
from nbv.dense.stereo import camera_center_m, choose_neighbours, pixel_matrix
import pycolmap
# isort: on

import numpy as np
from PIL import Image as PillowImage

from nbv.config import CameraConfig, DenseConfig
from nbv.dense.interface import Floats32, Image
from nbv.errors import UserError
from nbv.types import Floats

_MIN_DEPTH_M = 0.3


class PatchMatchBackend:
    """COLMAP's own stage of the paper; depth maps then go through our consistency check and fusion.

    Not bit-reproducible: COLMAP seeds its CUDA random numbers itself.

    Raises
    ------
    UserError
        The installed pycolmap has no CUDA.
    """

    name = "patchmatch"

    def __init__(self) -> None:
        if not pycolmap.has_cuda:
            raise UserError(
                'dense.backend=patchmatch needs a pycolmap with CUDA: run `pip install "gatetune[cuda]"` on a '
                "machine with an NVIDIA GPU, or set dense.backend=sgbm"
            )

    def depth_maps(
        self,
        images: Mapping[str, Image],
        camera_from_world: Mapping[str, Floats],
        camera: CameraConfig,
        target_m: tuple[float, float, float] | Floats,
        config: DenseConfig,
        surface_m: Floats | None = None,
    ) -> dict[str, Floats32]:
        """See `nbv.dense.interface.DepthBackend`; every view is matched with ``consistency_views`` others.

        Depths are sought within ``crop_half_width_m`` of the target, as in the SGBM backend without ``surface_m``.
        """
        target = np.asarray(target_m, dtype=float)
        poses = {name: camera_from_world[name] for name in sorted(images)}
        # PatchMatch weighs many sources per pixel, so it is given more than the pairwise matcher.
        wide = DenseConfig(
            neighbours=config.consistency_views,
            min_pair_angle_deg=config.min_pair_angle_deg,
            max_pair_angle_deg=config.max_pair_angle_deg,
            best_pair_angle_deg=config.best_pair_angle_deg,
            min_baseline_angle_deg=config.min_baseline_angle_deg,
        )
        sources = {name: choose_neighbours(name, poses, target, wide) for name in poses}
        sources = {name: chosen for name, chosen in sources.items() if chosen}
        if not sources:
            return {}
        distances = [float(np.linalg.norm(camera_center_m(poses[name]) - target)) for name in sources]
        options = pycolmap.PatchMatchOptions(
            depth_min=max(_MIN_DEPTH_M, min(distances) - config.crop_half_width_m),
            depth_max=max(distances) + config.crop_half_width_m,
            geom_consistency=True,
        )
        with tempfile.TemporaryDirectory(prefix="gatetune-patchmatch-") as folder:
            workspace = Path(folder)
            write_images(workspace, images, poses, camera)
            write_stereo_sources(workspace, sources)
            pycolmap.patch_match_stereo(workspace, options=options)
            return read_depth_maps(workspace, list(sources))


def write_images(
    workspace: Path,
    images: Mapping[str, Image],
    camera_from_world: Mapping[str, Floats],
    camera: CameraConfig,
) -> None:
    """Write photographs and their poses as COLMAP's dense workspace.

    COLMAP's stereo reads pixel centres at integers, so the principal point is written half a pixel off the sparse
    convention.

    Parameters
    ----------
    workspace
        Gets ``images/``, ``sparse/`` (binary model) and ``stereo/``.
    images
        (H, W, 3) RGB by name.
    camera_from_world
        (4, 4) by the same names, metres.
    camera
        Its intrinsics, the same for all.
    """
    for folder in (
        "images",
        "sparse",
        "stereo/depth_maps",
        "stereo/normal_maps",
        "stereo/consistency_graphs",
    ):
        (workspace / folder).mkdir(parents=True, exist_ok=True)
    matrix = pixel_matrix(camera)
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(
            camera_id=1,
            model="PINHOLE",
            width=camera.width_px,
            height=camera.height_px,
            params=[matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]],
        )
    )
    for image_id, name in enumerate(sorted(images), start=1):
        PillowImage.fromarray(images[name]).save(workspace / "images" / file_name(name))
        model.add_image_with_trivial_frame(
            pycolmap.Image(name=file_name(name), keypoints=np.zeros((0, 2)), camera_id=1, image_id=image_id),
            pycolmap.Rigid3d(np.asarray(camera_from_world[name], dtype=float)[:3]),
        )
    model.write(workspace / "sparse")


def write_stereo_sources(workspace: Path, sources: Mapping[str, Sequence[str]]) -> None:
    """Write ``patch-match.cfg``: the views that each reference view is matched with."""
    lines = []
    for name in sorted(sources):
        lines += [file_name(name), ", ".join(file_name(other) for other in sources[name])]
    (workspace / "stereo" / "patch-match.cfg").write_text("\n".join(lines) + "\n")


def read_depth_maps(workspace: Path, names: Sequence[str]) -> dict[str, Floats32]:
    """COLMAP's depths (H, W) in metres by view; NaN where it has none. Views without a file are left out."""
    maps = {}
    for name in sorted(names):
        file = workspace / "stereo" / "depth_maps" / f"{file_name(name)}.geometric.bin"
        if file.is_file():
            found = pycolmap.DepthMap()
            found.read(file)
            depth_m = np.array(found.to_array(), dtype=np.float32)
            maps[name] = np.where(depth_m > 0, depth_m, np.float32(np.nan))
    return maps


def file_name(view: str) -> str:
    """Image file name of a view; COLMAP wants a suffix."""
    return view if view.lower().endswith((".png", ".jpg", ".jpeg")) else f"{view}.png"
