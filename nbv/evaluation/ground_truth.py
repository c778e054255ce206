"""The reference surface: seeded samples of a mesh, which of them any mission could have seen, and what a perfect cloud of it would get.

A rock has surface that nobody can photograph (underside, deep holes), so ``gt -> cloud`` distances cannot reach zero however good the
views are: the floor of the Hausdorff distances says how far down they can go on one rock. A scan as it comes may have ground in one
sheet with the rock: cleaning takes it off a cloud, so it is no part of the reference either (`measured_faces`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nbv.cache import Arrays, Store, cached, cached_json
from nbv.config import EvaluationConfig, MissionConfig
from nbv.evaluation.cleaning import find_ground
from nbv.geometry.mesh import (
    RayCaster,
    face_areas,
    sample_surface,
    sample_surface_evenly,
    sums_by_voxel,
    weighted_normals,
)
from nbv.geometry.visibility import (
    OBSERVABLE_MAX_INCIDENCE_DEG,
    SURFACE_OFFSET_M,
    nearest_neighbours,
    seen_from,
)
from nbv.rocks import Rock
from nbv.types import Bools, Floats, Ints
from nbv.viewpoints import camera_shell

MIN_OBSERVING_VIEWS = 2  # a depth needs two rays
SAMPLES_PER_VOXEL = 2.0  # per voxel area of surface: with 4 the floors of two rocks moved by 0.4 mm or less
MIN_SAMPLES, MAX_SAMPLES = 1_000, 1_000_000
LEVEL = 0.7  # least z of the normal of ground
LEAST_GROUND = (
    0.03  # share of the surface: none of the catalogue's rocks has half as much level surface that low
)
GROUND_SAMPLES = 20_000
_BITS = 21  # of a voxel's key for each index: a million voxels either way from the origin
_SEED = 1  # not the ground truth's: equal samples would hide the sampling's own gaps


@dataclass(frozen=True)
class GroundTruthSamples:
    """Samples of the whole reference surface and the part of it that the camera shell can reach: elsewhere no planner can win or lose."""

    points_m: Floats  # (S, 3) world frame
    observable: Bools  # (S,)


def ground_truth(rock: Rock, config: MissionConfig, store: Store | None = None) -> GroundTruthSamples:
    """Samples of the true surface and the part that the camera shell can see; kept in ``store``."""
    shell, count = camera_shell(config), config.evaluation.gt_samples

    def make() -> Arrays:
        faces = measured_faces(rock.vertices_m, rock.faces, config.evaluation)
        points, normals = sample_surface_evenly(rock.vertices_m, faces, count, 0)
        caster = RayCaster(rock.vertices_m, rock.faces)
        return {"points_m": points, "observable": observable_mask(caster, points, normals, shell)}

    arrays = cached(
        store, "ground-truth", make, code=__name__, inputs=[rock.sha256, shell, config.evaluation]
    )
    return GroundTruthSamples(**arrays)


def measured_faces(vertices_m: Floats, faces: Ints, config: EvaluationConfig) -> Ints:
    """(F', 3) the faces (F, 3) without ground that is part of the mesh: what `clean_cloud` would take off a cloud of mesh and ground.

    The plane is sought as there, among what of the mesh is level and the ground z = 0 beside it, evenly sampled. All faces where less
    than `LEAST_GROUND` of the surface is level and as low as that plane.
    """
    points, normals = sample_surface(vertices_m, faces, GROUND_SAMPLES, 0)
    weighted = weighted_normals(vertices_m, faces)
    areas_m2 = np.linalg.norm(weighted, axis=1) / 2
    half_m, spacing_m = config.crop_half_extent_m, float(np.sqrt(areas_m2.sum() / GROUND_SAMPLES))
    steps_m = np.arange(-half_m, half_m, spacing_m)
    beside = np.stack(np.meshgrid(steps_m, steps_m, [0.0]), axis=-1).reshape(-1, 3)
    covered, cells = (np.floor(p[:, :2] / (2 * spacing_m)) @ [1e5, 1.0] for p in (points, beside))
    level = points[(normals[:, 2] > LEVEL) & (np.abs(points[:, :2]).max(axis=1) <= half_m)]
    plane = find_ground(np.concatenate([level, beside[~np.isin(cells, covered)]]), config, np.zeros(3))
    if plane is None:
        return faces
    low = plane.signed_distance_m(vertices_m[faces].mean(axis=1)) <= config.ground_ransac_threshold_m
    ground_m2 = areas_m2[low & (weighted[:, 2] > LEVEL * 2 * areas_m2)].sum()
    return faces[~low] if ground_m2 >= LEAST_GROUND * areas_m2.sum() else faces


def ground_share(rock: Rock, config: EvaluationConfig) -> float:
    """Share of the rock's surface that is ground, from 0 to 1 (`measured_faces`)."""
    measured = measured_faces(rock.vertices_m, rock.faces, config)
    return 1.0 - float(
        face_areas(rock.vertices_m, measured).sum() / face_areas(rock.vertices_m, rock.faces).sum()
    )


def observable_mask(caster: RayCaster, points_m: Floats, normals: Floats, camera_centers_m: Floats) -> Bools:
    """(S,) which of points (S, 3) with unit outward normals (S, 3) at least two of the reachable cameras (C, 3) see.

    A camera sees a sample that lies above the ground (z = 0), faces the camera with an incidence of at most 80 degrees,
    and is not hidden by the mesh (`nbv.geometry.visibility`). Image borders are ignored: cameras aim at the target and
    the rock fits the frame. With sample and camera above the ground, the ground plane cannot occlude.
    """
    starts = points_m + SURFACE_OFFSET_M * normals
    views = np.zeros(len(points_m), dtype=np.int64)
    open_samples: Ints = np.flatnonzero(points_m[:, 2] > 0)
    # Shuffled, since neighbours on a ring see the same samples: the first few then settle most of these. The result does
    # not depend on the order.
    for center in np.random.default_rng(0).permutation(camera_centers_m):
        if open_samples.size == 0:
            break
        facing = normals[open_samples]
        seen = seen_from(center, starts[open_samples], facing, caster, OBSERVABLE_MAX_INCIDENCE_DEG)
        views[open_samples[seen]] += 1
        open_samples = open_samples[views[open_samples] < MIN_OBSERVING_VIEWS]
    return views >= MIN_OBSERVING_VIEWS


def rock_floors(
    rock: Rock, truth: GroundTruthSamples, config: MissionConfig, store: Store | None = None
) -> dict[str, dict[str, float]]:
    """Hausdorff distances of `perfect_cloud` on both surfaces; empty dictionaries if nothing at all is observable above the ground cut.

    A real reconstruction needs more than two views of a place, so the floor is a lower bound, not a promise.
    """

    def make() -> dict[str, dict[str, float]]:
        cloud = perfect_cloud(rock, config)
        floors: dict[str, dict[str, float]] = {"whole": {}, "observable": {}}
        if len(cloud):
            wrong_m = RayCaster(rock.vertices_m, rock.faces).distances_m(cloud)
            missing_m, _ = nearest_neighbours(cloud, truth.points_m)
            for name, part in (("whole", missing_m), ("observable", missing_m[truth.observable])):
                forward, backward = (float((1000.0 * d).max()) for d in (part, wrong_m))
                floors[name] = {
                    "hausdorff_gt_to_cloud_floor_mm": forward,
                    "hausdorff_cloud_to_gt_floor_mm": backward,
                    "hausdorff_symmetric_floor_mm": max(forward, backward),
                }
        return floors

    inputs = [rock.sha256, camera_shell(config), config.dense.fusion_voxel_m, config.evaluation]
    floors: dict[str, dict[str, float]] = cached_json(store, "floors", make, code=__name__, inputs=inputs)
    return floors


def perfect_cloud(rock: Rock, config: MissionConfig) -> Floats:
    """(N, 3) points that a reconstruction without error or omission would leave after cleaning: `observable_mask`, averaged per voxel."""
    voxel_m = config.dense.fusion_voxel_m
    faces = measured_faces(rock.vertices_m, rock.faces, config.evaluation)
    wanted = SAMPLES_PER_VOXEL * float(face_areas(rock.vertices_m, faces).sum()) / voxel_m**2
    count = int(np.clip(wanted, MIN_SAMPLES, MAX_SAMPLES))
    samples, normals = sample_surface(rock.vertices_m, faces, count, _SEED)
    above_ground = samples[:, 2] > config.evaluation.ground_ransac_threshold_m
    samples, normals = samples[above_ground], normals[above_ground]
    if len(samples):
        caster = RayCaster(rock.vertices_m, rock.faces)
        samples = samples[observable_mask(caster, samples, normals, camera_shell(config))]
    if not len(samples):
        return samples
    x, y, z = np.floor(samples / voxel_m).astype(np.int64).T + (1 << _BITS - 1)
    sums, counts = sums_by_voxel(x << 2 * _BITS | y << _BITS | z, samples)
    return sums / counts[:, None]
