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
from nbv.config import IDEAL, SCORERS, MissionConfig
from nbv.errors import MissionFailure, UserError
from nbv.geometry.neighbours import nearest_neighbours
from nbv.mission.planning_state import load_state
from nbv.mission.run_directory import read_ply
from nbv.scorers import PAPER_SCORERS, find_scorer, rank_candidates
from nbv.types import CandidatePool, Floats, PlanningState
from tuner.missions.registry import PHOTOGRAPHS
from tuner.report.mission.run_files import (
    arrivals,
    mission_config,
    planned_config,
    read_flight,
    read_result,
    read_trace,
    thin_indices,
)
from tuner.report.mission.walk_world import (
    ERROR_STEP_MM,
    MISSING_STEP_MM,
    World,
    as_bytes,
    make_world,
    packed,
    packed_mesh,
    the_rock,
)

_MOST_DENSE_POINTS = 150_000
_THUMBNAIL_PX = 320
_BEST = 8  # candidates whose terms are shown
_TERMS = ("main", "nov", "move", "ang")


def walk_of(run: Path, rock: str | None = None) -> dict[str, Any]:
    """Everything that the page shows of the mission in ``run``, as JSON; arrays in it are packed strings.

    Parameters
    ----------
    run
        A mission's directory, flown with everything kept.
    rock
        Catalogue name or mesh file, for a rock that is not in the catalogue under the mission's name for it.

    Raises
    ------
    UserError
        A file is missing, or the rock is not the one that the mission was flown on.
    """
    result, flight = read_result(run), read_flight(run)
    planned_by, store = planned_config(run), Store()
    over_photographs = (
        result["provenance"].get("fidelity") == PHOTOGRAPHS
    )  # their camera, object and place are theirs
    config = planned_by if over_photographs else mission_config(run)
    world = make_world(config, the_rock(run, result, rock, store), store)
    states = sorted((run / "states").glob("iter_*.npz"))
    decided = [(*load_state(path), record) for path, record in zip(states, read_trace(run))]
    views, steps, models = _views(run, flight, decided), [], []
    seeds = [view for view in views if view["id"].startswith("seed_")]
    for number, view in enumerate(seeds, 1):
        steps.append(_step(f"seed view {number} of {len(seeds)}", number, view["t"]))
    for state, pool, record in decided:
        models.append(_sparse(world, state.model.points_m, state.model.track_lengths))
        step = _decision(world, planned_by, state, pool, record)
        now = float(views[min(len(state.visited_m), len(views)) - 1]["t"])
        steps.append(
            {**_step(step.pop("label"), len(state.visited_m), now), "model": len(models) - 1, **step}
        )
    final, dense = _final_model(run), _measured_cloud(run)
    missing_mm = _missing_mm(world, dense[0] if dense is not None else final[0] if final else None)
    end = _step("end of the mission", len(views), float(flight["flight_time_s"]))
    if final is not None:
        models.append(_sparse(world, *final))
        end["sparse_completeness"] = world.completeness(final[0])
        end["points"] = len(final[0])
    end["model"] = len(models) - 1
    steps.append({**end, "dense": dense is not None, "registered": result["costs"]["registered_images"]})
    camera = planned_by.camera
    return {
        "name": run.name,
        "status": result["status"],
        "message": result["message"],
        "rock": result["rock"],
        "replicate": result["replicate"],
        "condition": result.get("condition", IDEAL),
        "fidelity": result["provenance"].get("fidelity", ""),
        "gate": config.gate.kind,
        "headline": _headline(len(views), result["metrics"]),
        "scores": _scores(result["metrics"]),
        "target": [round(float(v), 4) for v in planned_by.target_m],
        "origin": world.origin_m.tolist(),
        "camera": [camera.width_px, camera.height_px, camera.focal_px],
        "mesh": packed_mesh(world),
        "truth": {
            "p": world.pack(world.truth_m),
            "m": packed(as_bytes(missing_mm / MISSING_STEP_MM), "u1"),
            "o": packed(world.observable, "u1"),
        },
        "truthAgainst": "dense cloud" if dense is not None else "sparse cloud",
        "dense": None if dense is None else _packed_dense(world, *dense),
        "models": models,
        "views": [{key: value for key, value in view.items() if key != "id"} for view in views],
        "steps": steps,
        "path": packed(np.array([sample[:4] for sample in flight["samples"]]), "<f4"),
    }


def _views(
    run: Path,
    flight: Mapping[str, Any],
    decided: list[tuple[PlanningState, CandidatePool, dict[str, Any]]],
) -> list[dict[str, Any]]:
    """Every photograph in the order in which they were taken: when, where from, and how it looks."""
    places = arrivals(flight)
    if decided:
        first = decided[0][0]
        places |= {f"seed_{i:02d}": place for i, place in enumerate(first.visited_m[: first.n_seeds])}
    lost = set()
    for _, pool, record in decided:
        places[record["chosen"]] = pool.positions_m[pool.ids.index(record["chosen"])]
        if not record["registered"]:
            lost.add(record["chosen"])
    if decided:
        registered = {Path(name).stem for name in decided[-1][0].model.camera_names}
        lost |= {name for name in places if name.startswith("seed_")} - registered
    views = []
    for event in flight["events"]:
        name = event["name"]
        if not name.startswith(("seed_", "cand_")):
            continue
        arrived_s = event["start_s"] + event["duration_s"]
        image = _thumbnail(run / "images" / f"{name}.png")
        views.append(
            {
                "id": name,
                "name": name,
                "t": round(arrived_s, 2),
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


def _step(label: str, views: int, time_s: float) -> dict[str, Any]:
    return {"label": label, "views": views, "t": round(time_s, 2), "model": -1}


def _decision(
    world: World, config: MissionConfig, state: PlanningState, pool: CandidatePool, record: dict[str, Any]
) -> dict[str, Any]:
    """What was known before an adaptive capture, and what was made of it."""
    flown, rankings = record["scorer"], {}
    try:
        scored = rank_candidates(state, pool, config)
        names = dict.fromkeys([*PAPER_SCORERS, *([flown] if flown in SCORERS else [])])
        rankings = {name: scored[name] for name in names}
    except MissionFailure:
        pass  # a random gate flies on without points
    weights = {name: find_scorer(name).weights(config) for name in rankings}
    signed = {n: (w.main, w.nov, -w.move, -w.ang) for n, w in weights.items()}
    return {
        "label": f"capture {state.iteration + 1}: chose {record['chosen']}",
        "chosen": record["chosen"],
        "scorer": flown,
        "reason": record["reason"],
        "d95_mm": round(1000 * state.d95_m, 2) if np.isfinite(state.d95_m) else None,
        "points": len(state.model.points_m),
        "registered": len(state.model.camera_names),
        "sparse_completeness": world.completeness(state.model.points_m),
        "pool": {
            "ids": list(pool.ids),
            "at": np.round(pool.positions_m, 3).tolist(),
            "scores": {name: np.round(ranking.scores, 4).tolist() for name, ranking in rankings.items()},
            "best": {
                name: [
                    {
                        "id": pool.ids[i],
                        "score": round(float(ranking.scores[i]), 4),
                        "terms": [
                            round(float(sign * ranking.terms[t][i]), 4)
                            for sign, t in zip(signed[name], _TERMS)
                        ],
                    }
                    for i in ranking.order[:_BEST]
                ]
                for name, ranking in rankings.items()
            },
        },
    }


def _sparse(world: World, points_m: Floats, lengths: np.ndarray) -> dict[str, str]:
    near = world.near(points_m)
    points = points_m[near]
    return {
        "p": world.pack(points),
        "e": packed(as_bytes(world.errors_mm(points) / ERROR_STEP_MM), "u1"),
        "n": packed(as_bytes(lengths[near]), "u1"),
    }


def _final_model(run: Path) -> tuple[Floats, np.ndarray] | None:
    """(N, 3) points and (N,) track lengths of the model of all photographs."""
    folder = run / "sparse" / "0"
    if not (folder / "points3D.bin").is_file():
        return None
    import pycolmap  # noqa: PLC0415  seconds to load

    points = [point for _, point in sorted(pycolmap.Reconstruction(folder).points3D.items())]
    lengths = np.array([point.track.length() for point in points])
    return np.array([point.xyz for point in points]).reshape(-1, 3), lengths


def _measured_cloud(run: Path) -> tuple[Floats, np.ndarray | None] | None:
    """The cloud that was measured."""
    for name in ("cleaned.ply", "dense.ply"):
        if (run / name).is_file():
            cloud = read_ply(run / name)
            kept = thin_indices(len(cloud), _MOST_DENSE_POINTS)
            return (
                (cloud.points_m[kept], None if cloud.colors is None else cloud.colors[kept])
                if len(kept)
                else None
            )
    return None


def _packed_dense(world: World, points_m: Floats, colors: np.ndarray | None) -> dict[str, str]:
    near = world.near(points_m)
    points = points_m[near]
    out = {
        "p": world.pack(points),
        "e": packed(as_bytes(world.errors_mm(points) / ERROR_STEP_MM), "u1"),
    }
    if colors is not None:
        out["c"] = packed(colors[near], "u1")
    return out


def _missing_mm(world: World, points_m: Floats | None) -> Floats:
    if points_m is None or len(points_m) == 0:
        return np.full(len(world.truth_m), np.inf)
    return 1000 * nearest_neighbours(points_m, world.truth_m)[0]


def _scores(metrics: Mapping[str, Any]) -> list[list[str]]:
    """The numbers of the whole mission, each with the surface that it is of."""
    wanted = (
        ("completeness_48mm", "completeness at 48 mm", "%"),
        ("f_score_16mm", "F-score at 16 mm", "%"),
        ("c2c_cloud_to_gt_mean_mm", "mean distance of the cloud to the truth", "mm"),
    )
    return [
        [f"{label}, {surface} surface", f"{metrics[surface][key]:.1f} {unit}"]
        for surface in ("observable", "whole")
        if surface in metrics
        for key, label, unit in wanted
        if isinstance(metrics[surface].get(key), (int, float))
    ]


def _headline(views: int, metrics: Mapping[str, Any]) -> str:
    """What the mission cost and what it got: the two numbers that a pair of missions is compared by."""
    said = f"{views} photographs"
    f_score = metrics.get("observable", {}).get("f_score_48mm")
    return f"{said}, F-score {f_score:.1f} % at 48 mm" if isinstance(f_score, (int, float)) else said
