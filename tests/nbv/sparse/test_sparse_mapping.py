"""The mapper and the reconstructor on a labelled synthetic world, and telemetry that errs."""

import dataclasses
import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sparse_world import CAMERA, CONFIG, LabelledPoints, mission, reported, ring_captures

from nbv.config import TELEMETRY_LEVELS, SparseConfig, TelemetryConfig
from nbv.errors import MissionFailure
from nbv.geometry.frames import align_umeyama, camera_centers_m
from nbv.sparse.colmap import camera_from_model_poses
from nbv.sparse.reconstructor import SparseReconstructor
from nbv.types import Capture

SEEDS = ring_captures(12)
LATER = ring_captures(6, radius_m=3.5, start=12, turn_deg=5.0)


def reconstructor(world, config=CONFIG):
    return SparseReconstructor(mission(config), world)


def reconstruct_all():
    sparse = reconstructor(LabelledPoints(SEEDS + LATER))
    reports = [sparse.bootstrap(SEEDS)] + [sparse.add(capture) for capture in LATER]
    return sparse, reports


@pytest.fixture(scope="module")
def reconstructed():
    return reconstruct_all()


def camera_errors_m(model, captures):
    truth = {c.name: camera_centers_m(c.camera_from_world) for c in captures}
    return np.array(
        [np.linalg.norm(c - truth[n]) for c, n in zip(model.camera_centers_m, model.camera_names)]
    )


def fingerprint(model):
    return b"".join(value.tobytes() for value in vars(model).values() if isinstance(value, np.ndarray))


def test_everything_registers_in_millimetres(reconstructed):
    sparse, reports = reconstructed
    assert all(report.registered and not report.message for report in reports)
    model = reports[-1].model
    assert model.camera_names == tuple(c.name for c in SEEDS + LATER)
    errors = camera_errors_m(model, SEEDS + LATER)
    assert errors.max() < 0.01
    assert model.alignment_rms_m == pytest.approx(np.sqrt((errors**2).mean()), rel=1e-9)
    assert model.alignment_max_m == pytest.approx(errors.max())
    assert sparse.reconstruction.camera(1).params == pytest.approx(
        [CAMERA.focal_px, CAMERA.focal_px, CAMERA.width_px / 2, CAMERA.height_px / 2], abs=0
    )  # known intrinsics are never refined


def test_same_bits_in_another_process(reconstructed):
    _, reports = reconstructed
    script = (
        "import hashlib, sys; sys.path[:0] = sys.argv[1:]\n"
        "from test_sparse_mapping import reconstruct_all, fingerprint\n"
        "print(hashlib.sha256(fingerprint(reconstruct_all()[1][-1].model)).hexdigest())"
    )
    here = Path(__file__).parent
    out = subprocess.run(
        [sys.executable, "-c", script, str(here), str(here.parents[1] / "support")],
        capture_output=True,
        text=True,
        check=True,
    )
    assert out.stdout.split()[-1] == hashlib.sha256(fingerprint(reports[-1].model)).hexdigest()


# ------------------------------------------------------------------------------------------ when it goes wrong


def test_an_image_left_out_is_tried_again_later():
    world = LabelledPoints(SEEDS + LATER)
    late, link = LATER[0], LATER[1]
    world.only_with = {12: {13}}  # matches nothing until view 13 has come
    sparse = reconstructor(world)
    sparse.bootstrap(SEEDS)
    refused = sparse.add(late)
    assert not refused.registered and "1 not registered so far, all tried again" in refused.message
    report = sparse.add(link)
    assert report.registered and late.name in report.model.camera_names
    assert f"now registered too: {late.name}" in report.message
    assert camera_errors_m(report.model, SEEDS + LATER).max() < 0.02


def test_a_pose_that_disagrees_with_telemetry_is_kept_out():
    world = LabelledPoints(SEEDS + LATER)
    sparse = reconstructor(world)
    before = sparse.bootstrap(SEEDS).model
    report = sparse.add(reported(LATER[0], (0.9, 0.0, 0.0)))
    assert not report.registered
    assert "0.90 m from telemetry" in report.message
    assert report.model.camera_names == before.camera_names
    assert report.model.alignment_rms_m == pytest.approx(before.alignment_rms_m, rel=1e-6)
    assert sparse.add(LATER[1]).registered


def test_a_seed_that_disagrees_with_telemetry_is_taken_out():
    seeds = [*SEEDS[:4], reported(SEEDS[4], (0.0, 0.8, 0.5)), *SEEDS[5:]]
    report = reconstructor(LabelledPoints(SEEDS)).bootstrap(seeds)
    assert SEEDS[4].name not in report.model.camera_names and len(report.model.camera_names) == 11
    assert SEEDS[4].name in report.message and "telemetry" in report.message
    assert report.model.alignment_max_m < 0.01
    assert report.model.track_cameras.max() <= 10


def test_blind_seeds_are_a_mission_failure():
    world = LabelledPoints(SEEDS)
    world.blind = set(range(12))
    with pytest.raises(MissionFailure) as caught:
        reconstructor(world).bootstrap(SEEDS)
    assert caught.value.reason == "seed_model_failed"
    world.blind = set(range(6, 12))
    with pytest.raises(MissionFailure, match="of 12 seed images registered") as caught:
        reconstructor(world).bootstrap(SEEDS)
    assert caught.value.reason == "seed_model_failed"


SIXTEEN = ring_captures(16)
PRIORS = SparseConfig(min_registered_seeds=8)


def noisy(noise_m: float) -> list[Capture]:
    """The seeds as telemetry with so much noise along every axis reports them."""
    rng = np.random.default_rng(6)
    return [reported(seed, rng.normal(0, noise_m, 3)) for seed in SIXTEEN]


def bootstrapped(captures: list[Capture], telemetry: TelemetryConfig) -> SparseReconstructor:
    sparse = SparseReconstructor(mission(PRIORS, telemetry), LabelledPoints(SIXTEEN))
    sparse.bootstrap(captures)
    return sparse


def test_priors_put_the_model_where_telemetry_says() -> None:
    captures = noisy(0.02)
    sparse = bootstrapped(captures, TELEMETRY_LEVELS["rtk"])
    own = camera_centers_m(camera_from_model_poses(sparse.reconstruction))  # COLMAP's frame, nothing aligned
    told = np.array([camera_centers_m(c.camera_from_world) for c in captures])
    true = np.array([camera_centers_m(c.camera_from_world) for c in SIXTEEN])
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
    world = LabelledPoints(SIXTEEN)
    share_few(world, last=15, neighbour=14)
    sparse = SparseReconstructor(mission(PRIORS, TELEMETRY_LEVELS[level]), world)
    before = sparse.bootstrap(SIXTEEN[:15]).model
    report = sparse.add(turned(SIXTEEN[15], turned_deg))
    assert report.registered == joins
    assert report.model.camera_names == (*before.camera_names, *[SIXTEEN[15].name] * joins)
    if joins:
        errors_m = report.model.camera_centers_m - np.array(
            [camera_centers_m(c.camera_from_world) for c in SIXTEEN]
        )
        assert np.linalg.norm(errors_m, axis=1).max() < 0.02
