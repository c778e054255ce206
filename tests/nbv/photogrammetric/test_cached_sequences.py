"""Photographs kept under all that they depend on; models, clouds, metrics by their sequence: same bits, or made anew."""

import dataclasses
import types

import numpy as np
import pytest
from sparse_world import CAMERA, CONFIG, TARGET, LabelledPoints, ring_captures

from nbv.cache import Store
from nbv.config import MissionConfig
from nbv.photogrammetric.reconstructor import PhotogrammetricReconstructor
from nbv.photogrammetric.simulated_camera import SimulatedCamera
from nbv.sparse.reconstructor import SparseReconstructor
from nbv.types import Viewpoint

SEEDS = ring_captures(12)
LATER = ring_captures(5, radius_m=3.5, start=12, turn_deg=5.0)
ELSEWHERE = ring_captures(2, radius_m=3.5, start=17, turn_deg=20.0)


class Counting(LabelledPoints):
    """Counts the photographs whose features are asked for."""

    asked = 0

    def features(self, image):
        self.asked += 1
        return super().features(image)


def reconstructor(world=None, store=None):
    config = dataclasses.replace(MissionConfig(), camera=CAMERA, sparse=CONFIG, target_m=tuple(TARGET))
    made = PhotogrammetricReconstructor(config, store)
    made._sparse = SparseReconstructor(config, world or Counting(SEEDS + LATER + ELSEWHERE))
    return made


def reconstruct_all(sparse, later):
    return [sparse.bootstrap(SEEDS)] + [sparse.add(capture) for capture in later]


def bits(reports):
    told = []
    for report in reports:
        told += [report.registered, report.message]
        told += [v.tobytes() if isinstance(v, np.ndarray) else v for v in vars(report.model).values()]
    return told


@pytest.mark.parametrize(
    ("later", "lost", "asked"),
    [
        (LATER, None, 0),  # the reconstructor behind does not move
        ([*LATER[:2], *ELSEWHERE], None, 16),
        (LATER, 3, 15),
    ],
    ids=["known", "left after two", "an entry in the middle was pruned"],
)
def test_what_is_kept_of_a_sequence_changes_no_bit(tmp_path, later, lost, asked):
    """Photographs are looked at again as far as something is not known."""
    expected = bits(reconstruct_all(reconstructor(), later)[1:])
    store = Store(tmp_path / "store")
    reconstruct_all(reconstructor(store=store), LATER)
    entries = sorted((store.root / "sequence-models").rglob("??/*"), key=lambda p: p.stat().st_mtime_ns)
    if lost is not None:
        entries[lost].unlink()
    world = Counting(SEEDS + LATER + ELSEWHERE)
    reports = reconstruct_all(reconstructor(world, store), later)
    assert bits(reports[1:]) == expected and world.asked == asked
    assert len(reports[0].model.camera_names) == len(SEEDS)
    assert all(entry.exists() for entry in entries)


def test_a_partial_model_leaves_nothing_behind(monkeypatch):
    """The model of the first six photographs, and afterwards the seed model that there would have been."""
    monkeypatch.setattr("nbv.photogrammetric.reconstructor.Correspondences", lambda *_: Counting(SEEDS))
    seen = reconstructor()
    model = seen.partial_model(SEEDS[:6])
    assert model is not None and model.camera_names == tuple(capture.name for capture in SEEDS[:6])
    assert seen.partial_model(SEEDS[:2]) is None
    assert bits([seen.bootstrap(SEEDS)]) == bits([reconstructor().bootstrap(SEEDS)])


VIEW = Viewpoint("seed_00", (0.0, -4.0, 1.5), 270.0, 10.0, "seed")


SHAPE = (32, 48, 3)


class CountingRenderer:
    """Grey pictures; ``drawn`` lists the cameras that were asked for."""

    def __init__(self) -> None:
        self.drawn = []

    def rgb(self, camera_from_world):
        return np.full((self.drawn[-1].height_px, self.drawn[-1].width_px, 3), 90, np.uint8)

    def made_for(self, camera):
        self.drawn.append(camera)
        return self


@pytest.mark.parametrize(
    "change",
    [
        {"sensor.jpeg_quality": 80},
        {"sensor.focal_error_percent": 0.5},
        {"scene.sun_elevation_deg": 30.0},
        {"scene.read_noise_dn": 2.0},
    ],
    ids=lambda change: next(iter(change)),
)
def test_another_camera_or_light_takes_another_photograph(tmp_path, change):
    rock = types.SimpleNamespace(sha256="a" * 64)
    ideal = MissionConfig().with_values({"camera.height_px": SHAPE[0], "camera.width_px": SHAPE[1]})
    renderer, images = CountingRenderer(), []
    for config in (ideal, ideal, ideal.with_values(change), ideal.with_values(change)):
        camera = SimulatedCamera(renderer.made_for, rock, 0, config, Store(tmp_path))
        images.append(camera.take_photograph(VIEW, np.array(VIEW.position_m), 0.0).image)
    assert len(renderer.drawn) == 2
    assert all(image.shape == SHAPE for image in images)
    assert np.array_equal(images[0], images[1])
    assert np.array_equal(images[2], images[3])
