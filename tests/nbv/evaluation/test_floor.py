"""The rock's own Hausdorff floor, on shapes where it is known."""

import numpy as np
import open3d as o3d
import pytest

from nbv.config import EvaluationConfig
from nbv.evaluation.floor import hausdorff_floors
from nbv.evaluation.ground_truth import build_ground_truth
from nbv.evaluation.metrics import compute_metrics
from nbv.geometry.raycasting import RayCaster
from nbv.types import PointCloud

VOXEL_M, CUT_M = 0.02, 0.03


def box(width_m: float, height_m: float):
    """A box that stands on the ground: its bottom is never visible."""
    mesh = o3d.geometry.TriangleMesh.create_box(width_m, width_m, height_m)
    mesh = mesh.translate((-width_m / 2, -width_m / 2, 0.0))
    return np.asarray(mesh.vertices), np.asarray(mesh.triangles).astype(np.int64)


def dome_of_cameras(radius_m: float = 3.5):
    return np.array(
        [
            [radius_m * np.cos(e) * np.cos(a), radius_m * np.cos(e) * np.sin(a), 0.5 + radius_m * np.sin(e)]
            for e in np.deg2rad([10.0, 30.0, 50.0])
            for a in np.linspace(0, 2 * np.pi, 24, endpoint=False)
        ]
    )


@pytest.fixture(scope="module")
def standing_box():
    vertices, faces = box(1.0, 0.8)
    cameras = dome_of_cameras()
    truth = build_ground_truth(vertices, faces, cameras, 20_000, 0)
    return vertices, faces, cameras, truth, hausdorff_floors(vertices, faces, truth, cameras, VOXEL_M, CUT_M)


def test_the_middle_of_an_invisible_bottom_is_the_floor(standing_box):
    *_, floors = standing_box
    # The centre of a 1 m square bottom is 0.5 m from its edges, where the visible sides begin 3 cm higher up.
    expected = 1000 * np.hypot(0.5, CUT_M)
    assert floors["whole"]["hausdorff_gt_to_cloud_floor_mm"] == pytest.approx(expected, abs=15)
    assert (
        floors["whole"]["hausdorff_symmetric_floor_mm"] == floors["whole"]["hausdorff_gt_to_cloud_floor_mm"]
    )
    # On the observable part only the ground cut and the gaps between voxels are left.
    observable = floors["observable"]["hausdorff_gt_to_cloud_floor_mm"]
    assert 1000 * CUT_M - 2 < observable < 1000 * (CUT_M + 2 * VOXEL_M)
    # Averaging pulls points off the surface at edges only, by less than a voxel.
    assert floors["whole"]["hausdorff_cloud_to_gt_floor_mm"] < 1000 * VOXEL_M


def test_no_real_cloud_beats_the_floor_by_more_than_a_voxel(standing_box):
    """The observable surface itself, without noise, measured as any other cloud, gets the floor."""
    vertices, faces, _, truth, floors = standing_box
    seen = truth.points_m[truth.observable & (truth.points_m[:, 2] > CUT_M)]
    metrics = compute_metrics(
        PointCloud(seen),
        truth,
        EvaluationConfig(),
        (0, 0, 0.4),
        RayCaster(vertices, faces).distances_m(seen),
        floors,
    )
    for surface in ("whole", "observable"):
        scores = metrics[surface]
        assert scores["hausdorff_gt_to_cloud_mm"] == pytest.approx(
            scores["hausdorff_gt_to_cloud_floor_mm"], abs=1000 * VOXEL_M
        )
    half = seen[seen[:, 0] > 0]
    worse = compute_metrics(PointCloud(half), truth, EvaluationConfig(), (0, 0, 0.4), None, floors)["whole"]
    assert worse["hausdorff_gt_to_cloud_mm"] > worse["hausdorff_gt_to_cloud_floor_mm"] + 100
