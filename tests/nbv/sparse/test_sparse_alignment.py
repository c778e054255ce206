import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from sparse_world import moved, ring_captures

from nbv.config import TELEMETRY_LEVELS
from nbv.errors import MissionFailure
from nbv.geometry.frames import camera_centers_m
from nbv.sparse.alignment import align_cameras
from nbv.sparse.colmap import camera_from_world_poses

TELEMETRY = np.array([c.camera_from_world for c in ring_captures(24)])


def in_model_frame(telemetry, scale, rotation, translation):
    """Poses in the frame ``model = scale * rotation @ world + translation``."""
    poses = telemetry.copy()
    poses[:, :3, :3] = telemetry[:, :3, :3] @ rotation.T
    poses[:, :3, 3] = scale * telemetry[:, :3, 3] - poses[:, :3, :3] @ translation
    return poses


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.floats(0.05, 20.0))
def test_undoes_any_similarity(seed, scale):
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(random_state=seed).as_matrix()
    model = in_model_frame(TELEMETRY, scale, rotation, rng.uniform(-50, 50, 3))
    alignment = align_cameras(model, TELEMETRY, 0.1)
    assert alignment.world_from_model.scale == pytest.approx(1 / scale, rel=1e-6)
    assert alignment.rms_m < 1e-6 and alignment.max_m < 1e-6 and len(alignment.outliers) == 0
    assert alignment.rotation_errors_deg.max() < 1e-3
    world = camera_from_world_poses(model, alignment.world_from_model)
    np.testing.assert_allclose(world, TELEMETRY, atol=1e-6)


@pytest.mark.parametrize("wrong", [(3,), (0, 7, 20)])
def test_names_the_few_cameras_that_disagree(wrong):
    model = TELEMETRY.copy()
    for index in wrong:
        model[index] = moved(model[index], (1.0, -0.7, 0.4 + 0.1 * index))
    model = in_model_frame(model, 2.5, Rotation.from_euler("xyz", [1, 2, 3]).as_matrix(), [3.0, 1.0, 2.0])
    alignment = align_cameras(model, TELEMETRY, 0.1)
    assert tuple(alignment.outliers) == wrong
    assert alignment.rms_m < 1e-6
    assert alignment.residuals_m[list(wrong)].min() > 1.0


def fails(model, telemetry=TELEMETRY, reason="wrong_model"):
    with pytest.raises(MissionFailure) as caught:
        align_cameras(model, telemetry, 0.1)
    assert caught.value.reason == reason
    return caught.value.message


def test_shuffled_telemetry_is_a_wrong_model():
    order = np.random.default_rng(1).permutation(24)
    assert "telemetry" in fails(TELEMETRY[order])


def test_a_mirrored_single_ring_is_found_by_its_orientations():
    """The centres of one ring lie in a plane, so that centres alone cannot tell its mirror image."""
    mirror = np.diag([1.0, 1.0, -1.0])
    ring = TELEMETRY[:12]
    model = ring.copy()
    model[:, :3, :3] = mirror @ ring[:, :3, :3] @ mirror
    model[:, :3, 3] = ring[:, :3, 3] @ mirror
    assert "mirrored" in fails(model, ring)


def test_collapsed_and_tiny_models():
    same = np.repeat(TELEMETRY[:1], 24, axis=0)
    assert "collapsed" in fails(same)
    assert "only 2" in fails(TELEMETRY[:2], TELEMETRY[:2])
    line = np.array([moved(TELEMETRY[0], (i, 0, 0)) for i in range(5)])
    assert "line" in fails(line, line)


def test_attitudes_hold_the_turn_that_drift_would_give():
    telemetry = TELEMETRY_LEVELS["gnss"]
    rng = np.random.default_rng(2)
    errors_deg = {False: [], True: []}
    for _ in range(20):
        reported = TELEMETRY.copy()
        centers = camera_centers_m(TELEMETRY) + rng.normal(0, 0.5, (len(TELEMETRY), 3))
        turns = Rotation.from_rotvec(np.deg2rad(rng.normal(0, 1.0, (len(TELEMETRY), 3)))).as_matrix()
        reported[:, :3, :3] = turns @ TELEMETRY[:, :3, :3]
        reported[:, :3, 3] = -np.einsum("mij,mj->mi", reported[:, :3, :3], centers)
        for uses in errors_deg:
            found = align_cameras(TELEMETRY, reported, 2.0, telemetry if uses else None).world_from_model
            errors_deg[uses].append(np.rad2deg(Rotation.from_matrix(found.rotation).magnitude()))
    assert np.mean(errors_deg[True]) < 0.5
    assert np.mean(errors_deg[True]) < np.mean(errors_deg[False]) / 4
