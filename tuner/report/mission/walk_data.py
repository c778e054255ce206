"""What the page of a mission shows in space, gathered from its directory and packed for a browser.

Points are packed as int16 in steps of a quarter of a millimetre from the target, distances as one byte: a mission of
32 photographs takes a few megabytes.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from nbv.cache import Store
from nbv.errors import UserError
from nbv.mission.planning_state import load_state
from nbv.mission.result import IterationRecord, MissionResult
from nbv.mission.run_directory import read_ply
from nbv.types import CandidatePool, Floats, PlanningState
from tuner.missions.registry import PHOTOGRAPHS
from tuner.report.mission.run_files import (
    arrivals,
    mission_config,
    planned_config,
    read_flight,
    thin_indices,
)
from tuner.report.mission.walk_world import make_world, packed, packed_mesh, the_rock

_MOST_DENSE_POINTS = 150_000
_THUMBNAIL_PX = 320
_SCORES = {"completeness_48mm": "completeness at 48 mm", "f_score_16mm": "F-score at 16 mm"}


def walk_of(run: Path, rock: str | None = None) -> dict[str, Any]:
    """Everything that the page shows of the mission in ``run``, flown with everything kept, as JSON; arrays are packed strings.

    ``rock`` as for `the_rock`; ``UserError`` as there, and where a file is missing.
    """
    result, flight, planned_by, store = (
        MissionResult.load(run),
        read_flight(run),
        planned_config(run),
        Store(),
    )
    fidelity = result.provenance.get("fidelity", "")
    # Over photographs camera, object and place are theirs.
    config = planned_by if fidelity == PHOTOGRAPHS else mission_config(run)
    world = make_world(config, the_rock(run, result, rock, store), store)
    states = sorted((run / "states").glob("iter_*.npz"))
    decided = [(*load_state(path), record) for path, record in zip(states, result.trace)]
    views = _views(run, flight, decided)
    seeds = sum(view["name"].startswith("seed_") for view in views)
    steps = [_step(f"seed view {n} of {seeds}", n, view["t"]) for n, view in enumerate(views[:seeds], 1)]
    models = []
    for state, pool, record in decided:
        models.append(world.cloud(state.model.points_m))
        taken = len(state.visited_m)
        label = f"capture {state.iteration + 1}: chose {record.chosen}"
        facts = [
            ["scorer", record.scorer],
            ["why", record.reason],
            ["candidates", str(len(pool))],
            ["registered", f"{len(state.model.camera_names)} of {taken} photographs"],
            ["sparse points", str(len(state.model.points_m))],
        ]
        now = views[min(taken, len(views)) - 1]["t"]
        step = _step(label, taken, now, len(models) - 1, facts)
        steps.append({**step, "pool": np.round(pool.positions_m, 3).tolist()})
    final, dense = _final_model(run), _measured_cloud(run)
    if final is not None:
        sparse, axes = final
        models.append(world.cloud(sparse))
        views = [{**view, "axes": axes[view["name"]]} if view["name"] in axes else view for view in views]
    facts = [
        ["registered", f"{result.costs['registered_images']:.0f} of {len(views)} photographs"],
        ["status", ": ".join(filter(None, (result.status, result.message)))],
        *_scores(result.metrics),
    ]
    steps.append(_step("end of the mission", len(views), flight["flight_time_s"], len(models) - 1, facts))
    what = (result.rock, f"replicate {result.replicate}", result.condition, config.gate.kind, fidelity)
    camera = planned_by.camera
    return {
        "name": run.name,
        "what": " · ".join(what),
        "headline": _headline(len(views), result.metrics),
        "target": [round(float(v), 4) for v in planned_by.target_m],
        "origin": world.origin_m.tolist(),
        "camera": [camera.width_px, camera.height_px, camera.focal_px],
        "seeds": seeds,
        "mesh": packed_mesh(world),
        "surface": "reference" if fidelity == PHOTOGRAPHS else "true rock",
        "missing": {"p": world.pack(world.missing_m(final[0] if dense is None and final else dense))},
        "against": "sparse" if dense is None else "dense",
        "dense": None if dense is None else world.cloud(dense),
        "models": models,
        "views": views,
        "steps": steps,
        "path": packed(np.array([sample[:4] for sample in flight["samples"]]), "<f4"),
    }


def _views(
    run: Path,
    flight: Mapping[str, Any],
    decided: list[tuple[PlanningState, CandidatePool, IterationRecord]],
) -> list[dict[str, Any]]:
    """Every photograph in the order in which they were taken: when, where from, and how it looks."""
    places, lost = arrivals(flight), set()
    for _, pool, record in decided:
        places[record.chosen] = pool.positions_m[pool.ids.index(record.chosen)]
        if not record.registered:
            lost.add(record.chosen)
    if decided:
        first, last = decided[0][0], decided[-1][0]
        places |= {f"seed_{i:02d}": place for i, place in enumerate(first.visited_m[: first.n_seeds])}
        registered = {Path(name).stem for name in last.model.camera_names}
        lost |= {name for name in places if name.startswith("seed_")} - registered
    views = []
    for event in flight["events"]:
        if (name := event["name"]) not in places:
            continue
        image = _thumbnail(run / "images" / f"{name}.png")
        views.append(
            {
                "name": name,
                "t": round(event["start_s"] + event["duration_s"], 2),
                "at": [round(float(v), 3) for v in places[name]],
                "lost": name in lost,
                **({"image": image} if image else {}),
            }
        )
    if not views:
        raise UserError(f"{run} took no photograph; there is nothing to walk around in")
    return views


def _thumbnail(path: Path) -> str | None:
    if not path.is_file():
        return None
    buffer = io.BytesIO()
    with Image.open(path) as image:
        small = image.convert("RGB")
        small.thumbnail((_THUMBNAIL_PX, _THUMBNAIL_PX))
        small.save(buffer, "JPEG", quality=72)
    return base64.b64encode(buffer.getvalue()).decode()


def _step(
    label: str, views: int, time_s: float, model: int = -1, facts: list[list[str]] | None = None
) -> dict[str, Any]:
    return {
        "label": label,
        "views": views,
        "t": round(float(time_s), 2),
        "model": model,
        "facts": facts or [],
    }


def _final_model(run: Path) -> tuple[Floats, dict[str, list[list[float]]]] | None:
    """Of the model of all photographs the points, (N, 3), and by photograph the camera's right, up and forward."""
    folder = run / "sparse" / "0"
    if not (folder / "points3D.bin").is_file():
        return None
    import pycolmap  # noqa: PLC0415  seconds to load

    model = pycolmap.Reconstruction(folder)
    points_m = np.array([model.points3D[i].xyz for i in sorted(model.points3D)]).reshape(-1, 3)
    flip = np.array([[1.0], [-1.0], [1.0]])  # OpenCV's y points down
    axes = {
        Path(image.name).stem: np.round(flip * image.cam_from_world().rotation.matrix(), 4).tolist()
        for image in model.images.values()
        if image.has_pose
    }
    return points_m, axes


def _measured_cloud(run: Path) -> Floats | None:
    """(N, 3) of the cloud that was measured."""
    file = next((run / name for name in ("cleaned.ply", "dense.ply") if (run / name).is_file()), None)
    points_m = np.zeros((0, 3)) if file is None else read_ply(file).points_m
    return points_m[thin_indices(len(points_m), _MOST_DENSE_POINTS)] if len(points_m) else None


def _scores(metrics: Mapping[str, Any]) -> list[list[str]]:
    """The numbers of the whole mission, each with the surface that it is of."""
    return [
        [f"{label}, {surface} surface", f"{metrics[surface][key]:.1f} %"]
        for surface in ("observable", "whole")
        if surface in metrics
        for key, label in _SCORES.items()
        if isinstance(metrics[surface].get(key), (int, float))
    ]


def _headline(views: int, metrics: Mapping[str, Any]) -> str:
    """What the mission cost and what it got: the two numbers that a pair of missions is compared by."""
    said = f"{views} photographs"
    f_score = metrics.get("observable", {}).get("f_score_48mm")
    return f"{said}, F-score {f_score:.1f} % at 48 mm" if isinstance(f_score, (int, float)) else said
