"""Telemetry that errs, as SfM meets it: a prior in the adjustment, and no reason to call a model wrong."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sparse_world import LabelledPoints, mission, reported, ring_captures

from nbv.config import TELEMETRY_LEVELS, SparseConfig, TelemetryConfig
from nbv.errors import MissionFailure
from nbv.geometry.frames import align_umeyama, camera_centers_m
from nbv.sparse.colmap import camera_from_model_poses
from nbv.sparse.reconstructor import SparseReconstructor
from nbv.types import Capture

SEEDS = ring_captures(16)
CONFIG = SparseConfig(min_registered_seeds=8)


def noisy(noise_m: float) -> list[Capture]:
    """The seeds as telemetry with so much noise along every axis reports them."""
    rng = np.random.default_rng(6)
    return [reported(seed, rng.normal(0, noise_m, 3)) for seed in SEEDS]


def bootstrapped(captures: list[Capture], telemetry: TelemetryConfig) -> SparseReconstructor:
    sparse = SparseReconstructor(mission(CONFIG, telemetry), LabelledPoints(SEEDS))
    sparse.bootstrap(captures)
    return sparse


def test_half_a_metre_of_noise_is_no_wrong_model() -> None:
    captures = noisy(0.5)
    with pytest.raises(MissionFailure, match="differ from telemetry") as failure:
        bootstrapped(captures, TELEMETRY_LEVELS["exact"])
    assert failure.value.reason == "wrong_model"
    sparse = bootstrapped(captures, TELEMETRY_LEVELS["gnss"])
    assert len(sparse.world_camera_poses()) == len(SEEDS)


def test_priors_put_the_model_where_telemetry_says() -> None:
    captures = noisy(0.02)
    sparse = bootstrapped(captures, TELEMETRY_LEVELS["rtk"])
    own = camera_centers_m(camera_from_model_poses(sparse.reconstruction))  # COLMAP's frame, nothing aligned
    told = np.array([camera_centers_m(c.camera_from_world) for c in captures])
    true = np.array([camera_centers_m(c.camera_from_world) for c in SEEDS])
    assert np.sqrt(((own - told) ** 2).sum(axis=1).mean()) < 0.05
    # Pixels hold the shape: it is far better than the positions that were told.
    shape_m = np.linalg.norm(align_umeyama(true, own).apply(own) - true, axis=1)
    assert np.sqrt((shape_m**2).mean()) < 0.01


def share_few(world: LabelledPoints, last: int, neighbour: int) -> None:
    """Of 20 matches of ``last`` 11 are with ``neighbour`` alone, so that 9 points are there to register by."""
    shared = np.intersect1d(world.labels[last], world.labels[neighbour])
    kept = shared[np.linspace(0, len(shared) - 1, 20).astype(int)]
    alone = kept[np.arange(20) % 20 >= 9]
    for index in world.labels:
        dropped = {last: ~np.isin(world.labels[last], kept), neighbour: np.zeros(0, bool)}.get(
            index, np.isin(world.labels[index], alone)
        )
        if len(dropped):
            world.labels[index], world.pixels[index] = (
                world.labels[index][~dropped],
                world.pixels[index][~dropped],
            )


def turned(capture: Capture, by_deg: float) -> Capture:
    """Its telemetry, about the camera's own centre."""
    pose = capture.camera_from_world.copy()
    pose[:3] = Rotation.from_euler("y", by_deg, degrees=True).as_matrix() @ pose[:3]
    return dataclasses.replace(capture, camera_from_world=pose)


@pytest.mark.parametrize(
    "level, turned_deg, joins", [("rtk", 0, True), ("rtk", 40, False), ("exact", 0, False)]
)
def test_few_shared_points_join_a_later_photograph(level, turned_deg, joins):
    world = LabelledPoints(SEEDS)
    share_few(world, last=15, neighbour=14)
    sparse = SparseReconstructor(mission(CONFIG, TELEMETRY_LEVELS[level]), world)
    before = sparse.bootstrap(SEEDS[:15]).model
    report = sparse.add(turned(SEEDS[15], turned_deg))
    assert report.registered == joins
    assert report.model.camera_names == (*before.camera_names, *[SEEDS[15].name] * joins)
    if joins:
        errors_m = report.model.camera_centers_m - np.array(
            [camera_centers_m(c.camera_from_world) for c in SEEDS]
        )
        assert np.linalg.norm(errors_m, axis=1).max() < 0.02
