"""What a run of theirs left: the dense cloud, and the cameras that align it with our world."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import trimesh

from nbv.errors import UserError
from nbv.safe_files import parse_json, read_text
from nbv.types import Floats
from tuner.bridges.photogrammetry_nbv.workspace import best_model, camera_centers

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
        No camera that COLMAP registered has its telemetry, or what they wrote cannot be read.
    """
    reported = _reported(run, float(stack.get("camera_up_m", 0)), float(stack.get("camera_forward_m", 0)))
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


def _reported(run: Path, up_m: float, forward_m: float) -> dict[str, Floats]:
    """By image file: the camera's centre (3,), east, north, up, from below the rock's centre.

    Theirs is where the vehicle was, north, east, down from take-off; the camera sits above and before it.
    """
    path, centers = run / "phase2_manifest.json", {}
    try:
        rock = _tree(path)["rock_center_ned_m"]
        north, east = float(rock["x"]), float(rock["y"])
        for path in sorted(run.glob("*/metadata/*.json")):
            entry = _tree(path)
            at, heading = entry.get("vehicle_position_ned_m"), float(entry.get("vehicle_heading_rad", 0.0))
            if at is None:  # the local position had dropped out
                continue
            centers[str(entry["image_file"])] = np.array(
                [
                    float(at["y"]) - east + forward_m * math.sin(heading),
                    float(at["x"]) - north + forward_m * math.cos(heading),
                    up_m - float(at["z"]),
                ]
            )
    except UserError as error:
        raise MissionUnfinishedError("machine", "unreadable_run", str(error)) from error
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise MissionUnfinishedError(
            "machine", "unreadable_run", f"{path} is not as theirs are: {type(error).__name__}: {error}"
        ) from error
    return centers


def _tree(path: Path) -> Any:
    return parse_json(read_text(path), str(path), finite=True)


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
