"""The Hausdorff distances that a perfect reconstruction would get: the rock's own floor.

A rock has surface that nobody can photograph (underside, deep holes), so ``gt -> cloud`` distances cannot
reach zero however good the views are. The floor says how far down they can go on one rock.
"""

from __future__ import annotations

import numpy as np

from nbv.evaluation.ground_truth import (
    GroundTruthSamples,
    observable_mask,
)
from nbv.evaluation.measures import hausdorff_mm
from nbv.evaluation.voxels import occupied_voxels
from nbv.geometry.neighbours import nearest_neighbours
from nbv.geometry.raycasting import RayCaster
from nbv.geometry.sampling import sample_surface
from nbv.types import Floats, Ints

SAMPLES_PER_VOXEL = 2.0  # per voxel area of surface: with 4 the floors of two rocks moved by 0.4 mm or less
MIN_SAMPLES, MAX_SAMPLES = 1_000, 1_000_000
_SEED = 1  # not the ground truth's: equal samples would hide the sampling's own gaps


def perfect_cloud(
    vertices_m: Floats, faces: Ints, camera_centers_m: Floats, voxel_m: float, ground_cut_m: float
) -> Floats:
    """(N, 3) points that a reconstruction without error or omission would leave after cleaning.

    Dense samples of the surface that at least two reachable cameras see (`observable_mask`), above the height
    up to which cleaning takes points for ground, averaged per voxel as fusion does. Empty if there are none.

    Parameters
    ----------
    voxel_m
        ``dense.fusion_voxel_m``; also decides how many samples are drawn.
    ground_cut_m
        ``evaluation.ground_ransac_threshold_m``, with the ground at z = 0.
    """
    corners = np.asarray(vertices_m, dtype=float)[np.asarray(faces)]
    area_m2 = float(
        np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
        / 2
    )
    wanted = SAMPLES_PER_VOXEL * area_m2 / voxel_m**2
    samples, normals = sample_surface(
        vertices_m, faces, int(np.clip(wanted, MIN_SAMPLES, MAX_SAMPLES)), _SEED
    )
    kept = samples[:, 2] > ground_cut_m
    samples, normals = samples[kept], normals[kept]
    if len(samples):
        samples = samples[observable_mask(vertices_m, faces, samples, normals, camera_centers_m)]
    return occupied_voxels(samples, voxel_m).means_m if len(samples) else samples


def hausdorff_floors(
    vertices_m: Floats,
    faces: Ints,
    truth: GroundTruthSamples,
    camera_centers_m: Floats,
    voxel_m: float,
    ground_cut_m: float,
) -> dict[str, dict[str, float]]:
    """``{"whole": {...}, "observable": {...}}``, each with ``hausdorff_{direction}_floor_mm``.

    The directions are those of the metrics (``gt_to_cloud``, ``cloud_to_gt``, ``symmetric``); the cloud is
    `perfect_cloud`, measured as any other. What is left of ``gt_to_cloud`` is surface that is never seen or
    cut away with the ground, and gaps of about a voxel; of ``cloud_to_gt``, what averaging in voxels moves off
    a curved surface. A real reconstruction needs more than two views of a place, so the floor is a lower
    bound, not a promise.

    Parameters
    ----------
    vertices_m, faces
        (V, 3) and (F, 3): the rock.
    truth
        Its ground-truth samples.

    Returns
    -------
    Empty dictionaries if nothing at all is observable above the ground cut.
    """
    cloud = perfect_cloud(vertices_m, faces, camera_centers_m, voxel_m, ground_cut_m)
    floors: dict[str, dict[str, float]] = {"whole": {}, "observable": {}}
    if len(cloud):
        to_gt = RayCaster(vertices_m, faces).distances_m(cloud)
        to_cloud, _ = nearest_neighbours(cloud, truth.points_m)
        for name, part in (("whole", to_cloud), ("observable", to_cloud[truth.observable])):
            distances = hausdorff_mm(part, to_gt)
            floors[name] = {key.removesuffix("_mm") + "_floor_mm": value for key, value in distances.items()}
    return floors
