"""What a run of theirs left: the dense cloud, and the cameras that align it with our world."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import trimesh

from adapters.photogrammetry_nbv.workspace import best_model, camera_centers
from nbv.foreign import parse_json
from nbv.types import Floats

_ROCK_HEIGHT_M = 1.6  # of an imported mesh (`nbv.rocks.import_mesh`)


class MissionUnfinishedError(Exception):
    """The mission ended without what can be measured."""

    def __init__(self, whose: Literal["configuration", "machine"], reason: str, message: str) -> None:
        super().__init__(message)
        self.whose, self.reason = whose, reason


def read_run(
    run: Path,
    facts: Mapping[str, Any],
    stack: Mapping[str, Any],
    target_m: tuple[float, float, float],
    folder: Path,
) -> tuple[dict[str, Any], dict[str, float]]:
    """``cloud`` and ``cost`` of a result; the cloud's path is relative to the folder above ``runs``.

    Raises
    ------
    MissionUnfinishedError
        No camera that COLMAP registered has its telemetry.
    """
    rock_ned = parse_json((run / "phase2_manifest.json").read_text(encoding="utf-8"), "phase2_manifest.json")[
        "rock_center_ned_m"
    ]
    reported = _reported(
        run, rock_ned, float(stack.get("camera_up_m", 0)), float(stack.get("camera_forward_m", 0))
    )
    if "mesh_scale" in facts:
        reported = _onto_our_mesh(reported, folder / facts["mesh"], float(facts["mesh_scale"]), target_m)
    estimated = camera_centers(best_model(run / "colmap"))
    cameras = {
        name: {"estimated": centre.tolist(), "reported": reported[name].tolist()}
        for name, centre in estimated.items()
        if name in reported
    }
    if len(cameras) < 3:
        raise MissionUnfinishedError(
            "machine", "not_aligned", f"{len(cameras)} of {len(estimated)} cameras have telemetry; it takes 3"
        )
    path = (run / "final" / "dense_cloud.ply").relative_to(run.parents[1])
    photographs = {kind: float(len([*(run / kind / "images").glob("*.*")])) for kind in ("seed", "adaptive")}
    cost = {
        **{f"{kind}_photographs": n for kind, n in photographs.items()},
        "registered": float(len(estimated)),
    }
    return {"path": str(path), "cameras": cameras}, cost


def _reported(run: Path, rock_ned: Mapping[str, float], up_m: float, forward_m: float) -> dict[str, Floats]:
    """By image file: the camera's centre (3,), east, north, up, from below the rock's centre.

    Theirs is where the vehicle was, north, east, down from take-off; the camera sits above and before it.
    """
    centers = {}
    for path in sorted(run.glob("*/metadata/*.json")):
        entry = parse_json(path.read_text(encoding="utf-8"), str(path))
        at, heading = entry.get("vehicle_position_ned_m"), entry.get("vehicle_heading_rad", 0.0)
        if at is None:  # the local position had dropped out
            continue
        centers[entry["image_file"]] = np.array(
            [
                at["y"] - rock_ned["y"] + forward_m * math.sin(heading),
                at["x"] - rock_ned["x"] + forward_m * math.cos(heading),
                up_m - at["z"],
            ]
        )
    return centers


def _onto_our_mesh(
    centers: dict[str, Floats], mesh: Path, scale: float, target_m: tuple[float, float, float]
) -> dict[str, Floats]:
    """Where the cameras are about the mesh as `nbv.rocks.import_mesh` places it.

    Their world has the mesh's origin at the rock's centre; ours its bounding box on the ground, 1.6 m tall.
    """
    low, high = trimesh.load(mesh, force="mesh", process=False).bounds
    origin = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    ours = _ROCK_HEIGHT_M / float(high[2] - low[2])
    return {name: ((c - np.array(target_m)) / scale - origin) * ours for name, c in centers.items()}
