"""The Hausdorff distances that a perfect reconstruction would get: the rock's own floor.

A rock has surface that nobody can photograph (underside, deep holes), so ``gt -> cloud`` distances cannot
reach zero however good the views are. The floor says how far down they can go on one rock.
"""

from __future__ import annotations

import numpy as np

from nbv.cache import Store, cached_json
from nbv.config import MissionConfig
from nbv.evaluation.ground_truth import GroundTruthSamples, observable_mask
from nbv.geometry.mesh import face_areas
from nbv.geometry.neighbours import nearest_neighbours
from nbv.geometry.raycasting import RayCaster
from nbv.geometry.sampling import sample_surface
from nbv.geometry.voxels import sums_by_voxel
from nbv.rocks import Rock
from nbv.types import Floats
from nbv.viewpoints import camera_shell

SAMPLES_PER_VOXEL = 2.0  # per voxel area of surface: with 4 the floors of two rocks moved by 0.4 mm or less
MIN_SAMPLES, MAX_SAMPLES = 1_000, 1_000_000
_BITS = 21  # of a voxel's key for each index: a million voxels either way from the origin
_SEED = 1  # not the ground truth's: equal samples would hide the sampling's own gaps


def rock_floors(
    rock: Rock, truth: GroundTruthSamples, config: MissionConfig, store: Store | None = None
) -> dict[str, dict[str, float]]:
    """Of `perfect_cloud` on both surfaces; empty dictionaries if nothing at all is observable above the ground cut.

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

    made_from = [config.dense.fusion_voxel_m, config.evaluation.ground_ransac_threshold_m]
    inputs = [rock.sha256, camera_shell(config), config.evaluation.gt_samples, *made_from]
    floors: dict[str, dict[str, float]] = cached_json(store, "floors", make, code=__name__, inputs=inputs)
    return floors


def perfect_cloud(rock: Rock, config: MissionConfig) -> Floats:
    """(N, 3) points that a reconstruction without error or omission would leave after cleaning: `observable_mask`, averaged per voxel."""
    voxel_m = config.dense.fusion_voxel_m
    wanted = SAMPLES_PER_VOXEL * float(face_areas(rock.vertices_m, rock.faces).sum()) / voxel_m**2
    count = int(np.clip(wanted, MIN_SAMPLES, MAX_SAMPLES))
    samples, normals = sample_surface(rock.vertices_m, rock.faces, count, _SEED)
    above_ground = samples[:, 2] > config.evaluation.ground_ransac_threshold_m
    samples, normals = samples[above_ground], normals[above_ground]
    if len(samples):
        caster = RayCaster(rock.vertices_m, rock.faces)
        samples = samples[observable_mask(caster, samples, normals, camera_shell(config))]
    return _voxel_means(samples, voxel_m) if len(samples) else samples


def _voxel_means(points_m: Floats, voxel_m: float) -> Floats:
    """(V, 3) means of the points (N, 3) in each occupied voxel of the size ``voxel_m``, the origin a corner of one."""
    x, y, z = np.floor(points_m / voxel_m).astype(np.int64).T + (1 << _BITS - 1)
    keys = x << 2 * _BITS | y << _BITS | z
    sums, counts = sums_by_voxel(keys, points_m)
    return sums / counts[:, None]
