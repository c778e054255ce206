"""The interactive 3D page of one mission, or of two beside each other.

What it shows in space is packed for a browser: points as int16 in steps of a quarter of a millimetre from the target,
distances as one byte. A mission of 32 photographs takes a few megabytes.
"""

from __future__ import annotations

import base64
import importlib.resources
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from PIL import Image

from nbv.cache import Store
from nbv.config import MissionConfig
from nbv.errors import UserError
from nbv.evaluation import ground_truth
from nbv.geometry.mesh import RayCaster
from nbv.geometry.ply import read_ply
from nbv.geometry.visibility import nearest_neighbours
from nbv.mission.planning_state import load_state
from nbv.mission.result import IterationRecord, MissionResult
from nbv.mission.run_directory import CLEANED, DENSE, IMAGES, SPARSE_MODEL, state_files
from nbv.rocks import Rock
from nbv.types import CandidatePool, Floats, PlanningState
from tuner.export.route import (
    FlightRecord,
    mission_config,
    planned_config,
    read_flight,
    rock_of_mission,
    thin_indices,
)
from tuner.missions.registry import mission_kind
from tuner.report.pages import write_page

STEP_M = 0.00025  # of a packed coordinate
ERROR_STEP_MM = 0.25  # of a packed distance to the truth: 64 mm at most
NEAR_M = 0.048  # the paper's threshold
_MOST_TRUTH_POINTS, _MOST_FACES, _MOST_DENSE_POINTS = 50_000, 60_000, 150_000
_THUMBNAIL_PX = 320
_SCORES = {"completeness_48mm": "completeness at 48 mm", "f_score_16mm": "F-score at 16 mm"}


def write_mission_view(runs: Sequence[Path], out: Path, rock: str | None = None) -> Path:
    """Write one HTML file, ``out``, that needs no server and no network: rock, clouds, cameras, pool, path, capture by capture.

    ``runs``: the directories of one or two missions that ran with everything kept; ``rock``: catalogue name or mesh
    file, by default the catalogue's rock of the mission's name for it.

    Raises
    ------
    UserError
        A file is missing, a rock is not the one of the mission, or ``out`` cannot be written.
    """
    missions = [_mission_data(run, rock) for run in runs]
    script = importlib.resources.files("tuner.report").joinpath("templates", "walk.js").read_text()
    title = " beside ".join(f"mission {mission['name']}" for mission in missions)
    data = json.dumps(missions, allow_nan=False).replace("<", "\\u003c")  # nothing in it can end the element
    return write_page(out, "walk.html.j2", title=title, data=Markup(data), script=Markup(script))


@dataclass(frozen=True)
class _Space:
    """The true rock, which the planner does not see, and the packing of coordinates."""

    config: MissionConfig
    rock: Rock
    caster: RayCaster
    origin_m: Floats  # of packed coordinates

    @staticmethod
    def of(config: MissionConfig, rock: Rock) -> _Space:
        origin_m = np.round(np.asarray(config.target_m, dtype=float), 3)
        return _Space(config, rock, RayCaster(rock.vertices_m, rock.faces), origin_m)

    def pack(self, points_m: Floats) -> str:
        """(N, 3) as int16."""
        return _packed(np.clip((points_m - self.origin_m) / STEP_M, -32767, 32767).round(), "<i2")

    def cloud(self, points_m: Floats) -> dict[str, str]:
        """Those of (N, 3) points that can be packed, with their distances to the nearer of rock and ground."""
        points_m = points_m[np.all(np.abs(points_m - self.origin_m) < 32000 * STEP_M, axis=1)]
        wrong_m = np.minimum(self.caster.distances_m(points_m), np.abs(points_m[:, 2]))
        steps = np.clip(1000 * wrong_m / ERROR_STEP_MM, 0, 255).round()
        return {"p": self.pack(points_m), "e": _packed(steps, "u1")}

    def missing(self, points_m: Floats | None, store: Store) -> dict[str, str]:
        """The samples of the surface that cameras can see without one of the (N, 3) points within `NEAR_M`."""
        truth = ground_truth(self.rock, self.config, store)
        samples_m = truth.points_m[truth.observable]
        samples_m = samples_m[thin_indices(len(samples_m), _MOST_TRUTH_POINTS)]
        if points_m is not None and len(points_m):
            samples_m = samples_m[nearest_neighbours(points_m, samples_m)[0] > NEAR_M]
        return {"p": self.pack(samples_m)}

    def mesh(self) -> dict[str, str]:
        """Vertices and faces, thinned out where there are many."""
        vertices, faces = self.rock.vertices_m, self.rock.faces
        if len(faces) > _MOST_FACES:
            import open3d as o3d  # noqa: PLC0415  seconds to load

            mesh = o3d.geometry.TriangleMesh(
                o3d.utility.Vector3dVector(np.array(vertices)), o3d.utility.Vector3iVector(np.array(faces))
            )
            # Clusters are quick; quadrics would take five seconds. A cell holds two faces where the surface is even.
            mesh = mesh.simplify_vertex_clustering(float(np.sqrt(2 * mesh.get_surface_area() / _MOST_FACES)))
            vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
        return {"p": self.pack(vertices), "f": _packed(faces, "<u4")}


def _mission_data(run: Path, rock: str | None) -> dict[str, Any]:
    """Everything that the page shows of the mission in ``run``, as JSON; arrays are packed strings."""
    result, flight, planned_by, store = (
        MissionResult.load(run),
        read_flight(run),
        planned_config(run),
        Store(),
    )
    fidelity = result.provenance.get("fidelity", "")
    over_set = mission_kind(fidelity).photographs == "taken"
    config = planned_by if over_set else mission_config(run)  # camera, object and place are the set's
    space = _Space.of(config, rock_of_mission(run, result, rock, store))
    # The planner's state, its candidates and what it decided, for every planned view.
    known = [(*load_state(path), record) for path, record in zip(state_files(run), result.trace)]
    views = _views(run, flight, known)
    seeds = sum(view["name"].startswith("seed_") for view in views)
    steps = [_step(f"seed view {n} of {seeds}", n, view["t"]) for n, view in enumerate(views[:seeds], 1)]
    models = []
    for state, pool, record in known:
        models.append(space.cloud(state.model.points_m))
        taken = len(state.visited_m)
        facts = [
            ["scorer", record.scorer],
            ["reason", record.reason],
            ["candidates", str(len(pool))],
            ["registered", f"{len(state.model.camera_names)} of {taken} photographs"],
            ["sparse points", str(len(state.model.points_m))],
        ]
        label, now = (
            f"capture {state.iteration + 1}: chose {record.chosen}",
            views[min(taken, len(views)) - 1],
        )
        step = _step(label, taken, now["t"], len(models) - 1, facts)
        steps.append({**step, "pool": np.round(pool.positions_m, 3).tolist()})
    final, dense = _final_model(run), None
    # The cloud that was measured.
    if (file := next((run / name for name in (CLEANED, DENSE) if (run / name).is_file()), None)) is not None:
        points_m = read_ply(file)[0].points_m
        dense = points_m[thin_indices(len(points_m), _MOST_DENSE_POINTS)] if len(points_m) else None
    if final is not None:
        sparse, axes = final
        models.append(space.cloud(sparse))
        views = [{**view, "axes": axes[view["name"]]} if view["name"] in axes else view for view in views]
    facts = [
        ["registered", f"{result.costs['registered_images']:.0f} of {len(views)} photographs"],
        ["status", ": ".join(filter(None, (result.status, result.message)))],
        *_scores(result.metrics),
        *_sectors(result.metrics),
    ]
    steps.append(_step("end of the mission", len(views), flight.duration_s, len(models) - 1, facts))
    headline = f"{len(views)} photographs"
    if isinstance(f_score := result.metrics.get("observable", {}).get("f_score_48mm"), (int, float)):
        headline += f", F-score {f_score:.1f} % at 48 mm"
    what = (result.rock, f"replicate {result.replicate}", result.condition, config.gate.kind, fidelity)
    camera = planned_by.camera
    return {
        "name": run.name,
        "what": " · ".join(what),
        "headline": headline,
        "target": [round(float(v), 4) for v in planned_by.target_m],
        "origin": space.origin_m.tolist(),
        "camera": [camera.width_px, camera.height_px, camera.focal_px],
        "seeds": seeds,
        "mesh": space.mesh(),
        "surface": "reference" if over_set else "true rock",
        "missing": space.missing(final[0] if dense is None and final else dense, store),
        "against": "sparse" if dense is None else "dense",
        "dense": None if dense is None else space.cloud(dense),
        "models": models,
        "views": views,
        "steps": steps,
        "path": _packed(flight.samples, "<f4"),
    }


def _views(
    run: Path, flight: FlightRecord, known: list[tuple[PlanningState, CandidatePool, IterationRecord]]
) -> list[dict[str, Any]]:
    """Every photograph in the order taken, with its time, position and thumbnail."""
    places, lost = flight.photographed_m(), set()
    for _, pool, record in known:
        places[record.chosen] = pool.positions_m[pool.ids.index(record.chosen)]
        if not record.registered:
            lost.add(record.chosen)
    if known:
        first, last = known[0][0], known[-1][0]
        places |= {f"seed_{i:02d}": place for i, place in enumerate(first.visited_m[: first.n_seeds])}
        registered = {Path(name).stem for name in last.model.camera_names}
        lost |= {name for name in places if name.startswith("seed_")} - registered
    views = []
    for name in flight.ends_s:
        if name not in places:
            continue
        image = _thumbnail(run / IMAGES / f"{name}.png")
        views.append(
            {
                "name": name,
                "t": round(flight.ends_s[name], 2),
                "at": [round(float(v), 3) for v in places[name]],
                "lost": name in lost,
                **({"image": image} if image else {}),
            }
        )
    if not views:
        raise UserError(f"{run} took no photograph; there is nothing to show")
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
    label: str, views: int, time_s: float, model: int = -1, facts: Sequence[list[str]] = ()
) -> dict[str, Any]:
    time_s = round(float(time_s), 2)
    return {"label": label, "views": views, "t": time_s, "model": model, "facts": list(facts)}


def _final_model(run: Path) -> tuple[Floats, dict[str, list[list[float]]]] | None:
    """Of the model of all photographs the points, (N, 3), and by photograph the camera's right, up and forward."""
    folder = run / SPARSE_MODEL
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


def _scores(metrics: Mapping[str, Any]) -> list[list[str]]:
    """The numbers of the whole mission, each with the surface that it is of."""
    return [
        [f"{label}, {surface} surface", f"{metrics[surface][key]:.1f} %"]
        for surface in ("observable", "whole")
        if surface in metrics
        for key, label in _SCORES.items()
        if isinstance(metrics[surface].get(key), (int, float))
    ]


def _sectors(metrics: Mapping[str, Any]) -> list[list[str]]:
    """Completeness by azimuth sector, as in the paper's Fig. 3; sector centres counter-clockwise from east."""
    shares = metrics.get("whole", {}).get("sector_completeness_48mm", ())
    named = [
        f"{centre:g}° {share:.0f} %"
        for centre, share in zip(metrics.get("sector_centers_deg", ()), shares)
        if share is not None
    ]
    return [["completeness at 48 mm by azimuth from east", ", ".join(named)]] if named else []


def _packed(values: np.ndarray, dtype: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype=dtype).tobytes()).decode()
