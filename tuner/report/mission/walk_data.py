"""What the page of a mission shows in space, gathered from its directory and packed for a browser.

Points are packed as int16 in steps of a quarter of a millimetre from the target, distances as one byte: a mission of
32 photographs takes a few megabytes.
"""

from __future__ import annotations

import base64
import io
import itertools
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from nbv.cache import Store
from nbv.config import IDEAL, SCORERS, MissionConfig, config_from_dict
from nbv.errors import MissionFailure, UserError
from nbv.evaluation import ground_truth
from nbv.foreign import read_yaml
from nbv.geometry.neighbours import nearest_neighbours
from nbv.geometry.raycasting import RayCaster
from nbv.mission.planning_state import load_state
from nbv.mission.run_directory import LOCATED, read_ply
from nbv.rocks import Rock, load_rock
from nbv.scorers import PAPER_SCORERS, find_scorer, rank_candidates
from nbv.terrain import lying_rock
from nbv.terrain.relief import relief_of
from nbv.types import CandidatePool, Floats, Ints, PlanningState, SparseModel
from tuner.report.mission.run_files import mission_config, read_json, read_trace
from tuner.report.mission.thinning import thin_indices

STEP_M = 0.00025  # of a packed coordinate
ERROR_STEP_MM = 0.25  # of a packed distance to the truth: 64 mm at most
MISSING_STEP_MM = 1.0  # of a packed distance of the truth to a cloud
NEAR_MM = 48.0  # the paper's threshold
_MOST_DENSE_POINTS, _MOST_TRUTH_POINTS, _MOST_FACES = 150_000, 50_000, 60_000
_THUMBNAIL_PX = 320
_BEST = 8  # candidates whose terms are shown
_TERMS = ("main", "nov", "move", "ang")


@dataclass(frozen=True)
class Walk:
    """One mission as it is shown: ``facts`` are JSON, arrays in them are packed strings."""

    name: str
    facts: dict[str, Any]


@dataclass(frozen=True)
class _World:
    """What is true, which only the page knows."""

    config: MissionConfig
    rock: Rock
    caster: RayCaster
    truth_m: Floats  # (S, 3)
    observable: np.ndarray  # (S,) bool
    origin_m: Floats  # of packed coordinates

    def pack(self, points_m: Floats) -> str:
        """(N, 3) as int16."""
        return _packed(np.clip((points_m - self.origin_m) / STEP_M, -32767, 32767).round(), "<i2")

    def near(self, points_m: Floats) -> np.ndarray:
        """(N,) which of the points can be packed."""
        near: np.ndarray = np.all(np.abs(points_m - self.origin_m) < 32000 * STEP_M, axis=1)
        return near

    def errors_mm(self, points_m: Floats) -> Floats:
        """(N,) distance to the nearer of the rock and the ground."""
        relief = relief_of(self.config.ground, self.config.scene.ground_seed)
        ground_m = 0.0 if relief is None else relief.height_m(points_m)
        rock_m = self.caster.distances_m(points_m)
        return 1000 * np.minimum(rock_m, np.abs(points_m[:, 2] - ground_m))

    def completeness(self, points_m: Floats) -> float | None:
        """Share (%) of the observable surface within `NEAR_MM` of the points."""
        if len(points_m) == 0 or not self.observable.any():
            return None
        seen = self.truth_m[self.observable]
        distances_m = nearest_neighbours(points_m, seen, within_m=2 * NEAR_MM / 1000)[0]
        return float(100 * np.mean(1000 * distances_m < NEAR_MM))


def walk_of(run: Path, rock: str | None = None) -> Walk:
    """Everything that the page shows of the mission in ``run``.

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
    result, flight = read_json(run, "mission.json"), read_json(run, "flight.json")
    config, store = mission_config(run), Store()
    planned_by = config_from_dict(read_yaml(run / LOCATED)) if (run / LOCATED).is_file() else config
    world = _world(config, _the_rock(run, result, rock, store), store)
    states = sorted((run / "states").glob("iter_*.npz"))
    decided = [(*load_state(path), record) for path, record in zip(states, read_trace(run))]
    views, steps, models = _views(run, flight, planned_by, decided), [], []
    seeds = [view for view in views if view["id"].startswith("seed_")]
    for number, view in enumerate(seeds, 1):
        steps.append(_step(f"seed view {number} of {len(seeds)}", number, view["t"]))
    for state, pool, record in decided:
        models.append(_sparse(world, state.model))
        step = _decision(world, planned_by, state, pool, record)
        now = float(views[min(len(state.visited_m), len(views)) - 1]["t"])
        steps.append(
            {**_step(step.pop("label"), len(state.visited_m), now), "model": len(models) - 1, **step}
        )
    final, dense = _final_model(run), _dense(run)
    missing_mm = _missing_mm(world, dense[0] if dense is not None else final.points_m if final else None)
    end = _step("end of the mission", len(views), float(flight["flight_time_s"]))
    if final is not None:
        models.append(_sparse(world, final))
        end["sparse_completeness"] = world.completeness(final.points_m)
        end["points"] = len(final.points_m)
    end["model"] = len(models) - 1
    steps.append({**end, "dense": dense is not None, "registered": result["costs"]["registered_images"]})
    camera = config.camera
    facts = {
        "name": run.name,
        "status": result["status"],
        "message": result["message"],
        "rock": result["rock"],
        "replicate": result["replicate"],
        "condition": result.get("condition", IDEAL),
        "fidelity": result["provenance"].get("fidelity", ""),
        "gate": config.gate.kind,
        "scores": _scores(result["metrics"]),
        "target": [round(float(v), 4) for v in planned_by.target_m],
        "origin": world.origin_m.tolist(),
        "camera": [camera.width_px, camera.height_px, camera.focal_px],
        "mesh": _mesh(world),
        "truth": {
            "p": world.pack(world.truth_m),
            "m": _packed(_bytes(missing_mm / MISSING_STEP_MM), "u1"),
            "o": _packed(world.observable, "u1"),
        },
        "truthAgainst": "dense cloud" if dense is not None else "sparse cloud",
        "dense": None if dense is None else _packed_dense(world, *dense),
        "models": models,
        "views": [{key: value for key, value in view.items() if key != "id"} for view in views],
        "steps": steps,
        "path": _packed(np.array([sample[:4] for sample in flight["samples"]]), "<f4"),
    }
    return Walk(run.name, facts)


def _the_rock(run: Path, result: Mapping[str, Any], rock: str | None, store: Store) -> Rock:
    name = rock or result["rock"]
    remedy = "name its mesh file with --rock"
    try:
        found = load_rock(name, store)
    except UserError as error:
        if rock is not None:
            raise
        raise UserError(
            f"{run} was flown on {name!r}, which the catalogue does not have; {remedy}"
        ) from error
    if found.sha256 != result["provenance"].get("rock_sha256", found.sha256):
        raise UserError(f"{run} was flown on another {name!r} than the one found now; {remedy}")
    return found


def _world(config: MissionConfig, found: Rock, store: Store) -> _World:
    rock = lying_rock(found, config)
    truth = ground_truth(rock, config, store)
    kept = thin_indices(len(truth.points_m), _MOST_TRUTH_POINTS)
    return _World(
        config,
        rock,
        RayCaster(rock.vertices_m, rock.faces),
        truth.points_m[kept],
        truth.observable[kept],
        np.round(np.asarray(config.target_m, dtype=float), 3),
    )


def _mesh(world: _World) -> dict[str, str]:
    vertices, faces = world.rock.vertices_m, world.rock.faces
    if len(faces) > _MOST_FACES:
        vertices, faces = _fewer_faces(vertices, faces)
    return {"p": world.pack(vertices), "f": _packed(faces, "<u4")}


def _fewer_faces(vertices_m: Floats, faces: Ints) -> tuple[Floats, Ints]:
    import open3d as o3d  # noqa: PLC0415  seconds to load

    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.array(vertices_m)), o3d.utility.Vector3iVector(np.array(faces))
    )
    # Clusters are quick; quadrics would take five seconds. A cell holds two faces where the surface is even.
    mesh = mesh.simplify_vertex_clustering(float(np.sqrt(2 * mesh.get_surface_area() / _MOST_FACES)))
    return np.asarray(mesh.vertices), np.asarray(mesh.triangles)


def _views(
    run: Path,
    flight: Mapping[str, Any],
    config: MissionConfig,
    decided: list[tuple[PlanningState, CandidatePool, dict[str, Any]]],
) -> list[dict[str, Any]]:
    """Every photograph in the order in which they were taken: when, where from, and how it looks."""
    places: dict[str, Floats] = {}
    if decided:
        first = decided[0][0]
        places = {f"seed_{i:02d}": place for i, place in enumerate(first.visited_m[: first.n_seeds])}
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
        place = places.get(name)
        if place is None:  # a mission that ended before it planned
            samples = np.array([sample[:4] for sample in flight["samples"]])
            place = samples[np.searchsorted(samples[:, 0], arrived_s).clip(max=len(samples) - 1), 1:]
        image = _thumbnail(run / "images" / f"{name}.png")
        views.append(
            {
                "id": name,
                "name": name,
                "t": round(arrived_s, 2),
                "at": [round(float(v), 3) for v in place],
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
    world: _World, config: MissionConfig, state: PlanningState, pool: CandidatePool, record: dict[str, Any]
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


def _sparse(world: _World, model: SparseModel) -> dict[str, str]:
    near = world.near(model.points_m)
    points = model.points_m[near]
    return {
        "p": world.pack(points),
        "e": _packed(_bytes(world.errors_mm(points) / ERROR_STEP_MM), "u1"),
        "n": _packed(_bytes(model.track_lengths[near]), "u1"),
    }


def _final_model(run: Path) -> SparseModel | None:
    folder = run / "sparse" / "0"
    if not (folder / "points3D.bin").is_file():
        return None
    import pycolmap  # noqa: PLC0415  seconds to load

    found = pycolmap.Reconstruction(folder)
    points = sorted(found.points3D.items())
    lengths = [point.track.length() for _, point in points]
    return SparseModel(
        np.array([point.xyz for _, point in points]).reshape(-1, 3),
        np.array([point.error for _, point in points]),
        np.array([0, *itertools.accumulate(lengths)]),
        np.zeros(sum(lengths), dtype=np.int64),
        np.zeros((0, 3)),
        (),
        0.0,
        0.0,
    )


def _dense(run: Path) -> tuple[Floats, np.ndarray | None] | None:
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


def _packed_dense(world: _World, points_m: Floats, colors: np.ndarray | None) -> dict[str, str]:
    near = world.near(points_m)
    points = points_m[near]
    packed = {
        "p": world.pack(points),
        "e": _packed(_bytes(world.errors_mm(points) / ERROR_STEP_MM), "u1"),
    }
    if colors is not None:
        packed["c"] = _packed(colors[near], "u1")
    return packed


def _missing_mm(world: _World, points_m: Floats | None) -> Floats:
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


def _bytes(values: np.ndarray) -> np.ndarray:
    return np.clip(np.nan_to_num(values, posinf=255.0), 0, 255).round()


def _packed(values: np.ndarray, dtype: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype=dtype).tobytes()).decode()


def as_json(walks: list[Walk]) -> str:
    """For a script element: nothing in it can end the element."""
    return json.dumps([walk.facts for walk in walks], allow_nan=False).replace("</", "<\\/")
