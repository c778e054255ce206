"""What is true of a mission's rock, for the page that shows it; and how arrays are packed for a browser."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nbv.cache import Store
from nbv.config import MissionConfig
from nbv.errors import UserError
from nbv.evaluation import ground_truth
from nbv.geometry.neighbours import nearest_neighbours
from nbv.geometry.raycasting import RayCaster
from nbv.mission.result import MissionResult
from nbv.rocks import Rock, load_coarse_rock, load_rock
from nbv.terrain import buried_rock
from nbv.terrain.relief import relief_of
from nbv.types import Floats, Ints
from tuner.report.mission.run_files import thin_indices

STEP_M = 0.00025  # of a packed coordinate
ERROR_STEP_MM = 0.25  # of a packed distance to the truth: 64 mm at most
NEAR_M = 0.048  # the paper's threshold
_MOST_TRUTH_POINTS, _MOST_FACES = 50_000, 60_000


@dataclass(frozen=True)
class World:
    """What is true, which only the page knows."""

    config: MissionConfig
    rock: Rock
    caster: RayCaster
    observable_m: Floats  # (S, 3) samples of the surface that cameras can see
    origin_m: Floats  # of packed coordinates

    def pack(self, points_m: Floats) -> str:
        """(N, 3) as int16."""
        return packed(np.clip((points_m - self.origin_m) / STEP_M, -32767, 32767).round(), "<i2")

    def cloud(self, points_m: Floats) -> dict[str, str]:
        """Those of (N, 3) points that can be packed, with their distances to the nearer of rock and ground."""
        points_m = points_m[np.all(np.abs(points_m - self.origin_m) < 32000 * STEP_M, axis=1)]
        relief = relief_of(self.config.ground, self.config.scene.ground_seed)
        ground_m = 0.0 if relief is None else relief.height_m(points_m)
        wrong_m = np.minimum(self.caster.distances_m(points_m), np.abs(points_m[:, 2] - ground_m))
        steps = np.clip(1000 * wrong_m / ERROR_STEP_MM, 0, 255).round()
        return {"p": self.pack(points_m), "e": packed(steps, "u1")}

    def missing_m(self, points_m: Floats | None) -> Floats:
        """(M, 3) samples of the observable surface without one of the points within `NEAR_M`."""
        if points_m is None or len(points_m) == 0:
            return self.observable_m
        return self.observable_m[nearest_neighbours(points_m, self.observable_m)[0] > NEAR_M]


def the_rock(run: Path, result: MissionResult, rock: str | None, store: Store) -> Rock:
    """The rock that the mission in ``run`` was flown on; ``UserError`` if the one found is another.

    Parameters
    ----------
    run, result
        The mission's directory, and its result.
    rock
        Catalogue name or mesh file, for a rock that is not in the catalogue under the mission's name for it.
    store
        Where rocks are kept.
    """
    name = rock or result.rock
    remedy = "name its mesh file with --rock"
    try:
        # As the mission loaded it.
        load = load_coarse_rock if result.provenance.get("fidelity") == "geometric" else load_rock
        found = load(name, store)
    except UserError as error:
        if rock is not None:
            raise
        raise UserError(
            f"{run} was flown on {name!r}, which the catalogue does not have; {remedy}"
        ) from error
    if found.sha256 != result.provenance.get("rock_sha256", found.sha256):
        raise UserError(f"{run} was flown on another {name!r} than the one found now; {remedy}")
    return found


def make_world(config: MissionConfig, found: Rock, store: Store) -> World:
    """The rock as it lay, and the samples that the metrics are made of."""
    rock = buried_rock(found, config)
    truth = ground_truth(rock, config, store)
    observable_m = truth.points_m[truth.observable]
    return World(
        config,
        rock,
        RayCaster(rock.vertices_m, rock.faces),
        observable_m[thin_indices(len(observable_m), _MOST_TRUTH_POINTS)],
        np.round(np.asarray(config.target_m, dtype=float), 3),
    )


def packed_mesh(world: World) -> dict[str, str]:
    """Vertices and faces, thinned out where there are many."""
    vertices, faces = world.rock.vertices_m, world.rock.faces
    if len(faces) > _MOST_FACES:
        vertices, faces = _fewer_faces(vertices, faces)
    return {"p": world.pack(vertices), "f": packed(faces, "<u4")}


def _fewer_faces(vertices_m: Floats, faces: Ints) -> tuple[Floats, Ints]:
    import open3d as o3d  # noqa: PLC0415  seconds to load

    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.array(vertices_m)), o3d.utility.Vector3iVector(np.array(faces))
    )
    # Clusters are quick; quadrics would take five seconds. A cell holds two faces where the surface is even.
    mesh = mesh.simplify_vertex_clustering(float(np.sqrt(2 * mesh.get_surface_area() / _MOST_FACES)))
    return np.asarray(mesh.vertices), np.asarray(mesh.triangles)


def packed(values: np.ndarray, dtype: str) -> str:
    """The array\'s bytes in base64."""
    return base64.b64encode(np.ascontiguousarray(values, dtype=dtype).tobytes()).decode()
