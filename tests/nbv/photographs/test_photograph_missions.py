"""Missions over photographs: where they may look from, what they are measured by, and one from end to end."""

from dataclasses import replace
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest
from photographed_ball import CAMERA, spread, write_set
from PIL import Image
from refusals import refused
from scene_helpers import CENTRE_M, around

from nbv import plugins
from nbv.config import preset
from nbv.config.presets import PHOTOGRAPH_SET_DEFAULTS
from nbv.errors import MissionFailure
from nbv.evaluation.registry import Metric
from nbv.geometry.frames import Similarity
from nbv.photographs import PhotographSet
from nbv.photographs.photograph_fidelity import (
    SEED_CAP_DEG,
    PhotographViewpoints,
    config_for_set,
    measure_cloud,
    run_photographs_mission,
)
from nbv.rocks import list_rocks, load_rock
from nbv.types import PointCloud
from tuner.campaign.settings_file import merged_settings
from tuner.missions.registry import kind_on, mission_kind, usual_preset

PAPER = preset("campaign")
RING = PAPER.with_values({"seeds": 16, "seed.layout": "turn", "seed.lowest_deg": 25.0})
NEAREST = Metric(
    "nearest_mm", "Nearest", "mm", False, lambda distances, t: float(distances.to_cloud_mm.min())
)


def viewpoints(positions_m: np.ndarray, config=RING, replicate: int = 0) -> PhotographViewpoints:
    return PhotographViewpoints(positions_m, CENTRE_M, config, "key", replicate)


def in_order(positions_m: np.ndarray, views) -> list[int]:
    return [int(np.linalg.norm(positions_m - v.position_m, axis=1).argmin()) for v in views]


def test_seeds_are_the_nearest_photographs_each_taken_once() -> None:
    # Two photographs near every second viewpoint, of which the nearer is taken; none is taken twice.
    north_first = 90.0 - np.arange(16) * 22.5
    at = around(np.concatenate([north_first + 3.0, north_first + 5.0]), np.full(32, 25.0))
    chosen = in_order(at, viewpoints(at).seeds(RING))
    assert chosen == list(range(16))
    crowded = around(north_first[[0] * 16] + np.arange(16) * 1.0, np.full(16, 25.0))
    with pytest.raises(MissionFailure, match="seeds have a photograph within 20 degrees"):
        viewpoints(crowded).seeds(RING)


def test_a_side_without_photographs_costs_its_seeds_alone() -> None:
    """A gap of 130 degrees: 11 to 13 of 16 places are near a photograph, and as many of more; of a small side nothing is flown."""
    at = around(np.arange(0.0, 231.0, 5.0), 25.0)
    for count in (16, 24, 32):
        config = PAPER.with_values({"seeds": count, "seed.layout": "turn", "seed.lowest_deg": 25.0})
        seeds = viewpoints(at, config).seeds(config)
        assert 0.68 * count <= len(seeds) <= 0.82 * count and len({s.position_m for s in seeds}) == len(seeds)
    above = RING.with_values({"seed.lowest_deg": 25.0 + SEED_CAP_DEG + 1})
    with pytest.raises(MissionFailure, match="46 to 46 degrees, and the photographs have 25 to 25"):
        viewpoints(at).seeds(above)
    few = around(np.arange(0.0, 61.0, 2.0), 25.0)
    with pytest.raises(MissionFailure, match="in azimuth: none was taken between 60° and 0°"):
        viewpoints(few).seeds(RING)


def test_the_pool_is_what_is_left_within_the_altitudes() -> None:
    at = np.concatenate([around(np.arange(0, 360, 30.0), np.full(12, e)) for e in (5.0, 20.0, 50.0)])
    lowest, highest = (0.8 + 3.5 * np.sin(np.deg2rad(e)) for e in (10.0, 60.0))
    config = PAPER.with_values({"pool.min_altitude_m": lowest, "pool.max_altitude_m": highest})
    pool = viewpoints(at, config).candidates(config, at[0], at[[12, 13, 30]], 2)
    assert sorted(in_order(at, [pool.viewpoint(i) for i in range(len(pool))])) == [
        i for i in range(12, 36) if i not in (12, 13, 30)
    ]
    assert pool.counts == {"raw": 36, "revisit": 33, "altitude_travel": 21}
    assert {pool.viewpoint(i).band for i in range(len(pool))} == {"lateral", "upper"}
    everything = viewpoints(at, config).candidates(config, at[0], at, 2)
    assert len(everything) == 0


@pytest.fixture
def grey_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> PhotographSet:
    monkeypatch.setenv("GATETUNE_HOME", str(tmp_path))
    return write_set("ball", spread(20), rendered=False)


def test_what_nobody_chose_is_as_photographs_need_it_and_what_is_set_stands(grey_set):
    believed = config_for_set(PAPER, grey_set).dense
    assert (believed.agreeing_views, believed.search, believed.max_size_px) == (3, "sparse", 480)
    assert (usual_preset(["ball"]), usual_preset(["ball", "slab"])) == ("photographs", "campaign")
    base = preset(usual_preset(["ball"]))
    assert config_for_set(base, grey_set) == replace(config_for_set(PAPER, grey_set), preset="photographs")
    chosen = {path: attrgetter(path)(PAPER) for path in PHOTOGRAPH_SET_DEFAULTS}  # though a preset has it
    asked = base.with_values(chosen)
    believed = config_for_set(asked, grey_set)
    assert believed.with_values(chosen) == believed
    assert asked.sparse == believed.sparse  # what is recorded is what runs


def test_the_reference_itself_scores_everything_wherever_it_lies(grey_set: PhotographSet) -> None:
    reference = grey_set.reference()
    c, s = np.cos(0.02), np.sin(0.02)
    moved = Similarity(1.03, np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array([0.03, -0.02, 0.02]))
    cloud = PointCloud(moved.apply(reference.points_m), reference.colors, None)
    metrics = measure_cloud(cloud, grey_set, PAPER.evaluation).metrics
    assert metrics["observable"]["f_score_16mm"] > 97.0  # cleaning takes strays along
    assert metrics["whole"] == metrics["observable"]
    assert metrics["reference"]["registration"]["scale"] == pytest.approx(1 / 1.03, abs=2e-3)
    assert metrics["reference"]["ceiling"]["f_score_48mm"] == 99.0
    half = reference.points_m[:, 0] > 0
    cloud = PointCloud(reference.points_m[half], None, None)
    metrics = measure_cloud(cloud, grey_set, PAPER.evaluation).metrics
    # A ball of 1.6 m is complete as far as 48 mm beyond its middle: (0.8 + 0.048) / 1.6 of its surface (Archimedes).
    assert metrics["observable"]["completeness_48mm"] == pytest.approx(53.0, abs=1.0)


def test_what_masks_say_is_not_the_object_does_not_count(grey_set: PhotographSet) -> None:
    reference = grey_set.reference()
    angle, radius = np.random.default_rng(0).uniform([[0.0], [0.8]], [[2 * np.pi], [0.9]], (2, 20_000))
    plinth = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(20_000, 0.25)])
    cloud = PointCloud(np.concatenate([reference.points_m, plinth]), None, None)
    before = measure_cloud(cloud, grey_set, PAPER.evaluation).metrics["whole"]
    v, u = np.indices((CAMERA.height_px, CAMERA.width_px))
    radius_px = CAMERA.focal_px * (grey_set.height_m / 2) / 3.4
    disc = (
        np.hypot(u - CAMERA.width_px / 2, v - CAMERA.height_px / 2) < radius_px
    )  # the ball, seen from 3.5 m
    for photograph in grey_set.photographs:
        Image.fromarray(disc.astype(np.uint8) * 255).save(
            grey_set.folder / "masks" / f"{photograph.name}.png"
        )
    masked = replace(grey_set, photographs=tuple(replace(p, masked=True) for p in grey_set.photographs))
    after = measure_cloud(cloud, masked, PAPER.evaluation).metrics["whole"]
    assert before["accuracy_48mm"] < 80.0 and after["accuracy_48mm"] > 99.0
    assert after["completeness_48mm"] > 99.0


def test_a_set_stands_where_a_rock_stands(grey_set: PhotographSet) -> None:
    assert load_rock("ball").name == "ball"
    assert {info.source for info in list_rocks() if info.name == "ball"} == {"photographs"}
    over_photographs = mission_kind("photographs")
    assert kind_on("ball", "photogrammetric") is kind_on("ball", "geometric") is over_photographs
    assert kind_on("slab", "photogrammetric").photographs == "rendered"
    for rock, preset_name in (("ball", "photographs"), ("slab", "campaign-reduced")):
        assert merged_settings(None, {"rocks": [rock]}, quick=True)["preset"] == preset_name
    refused("photographs missions cannot run on slab", kind_on, "slab", "photographs")


@pytest.mark.slow
def test_a_mission_over_photographs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GATETUNE_HOME", str(tmp_path))
    write_set("ball", spread(32), rendered=True)
    config = PAPER.with_values(
        {
            "photographs": 18,
            "seeds": 16,
            "seed.layout": "turn",
            "seed.lowest_deg": 25.0,
            "telemetry": "rtk",  # the target is not looked for even so
            "dense.agreeing_views": 3,
            "dense.search": "sparse",
            "dense.max_size_px": 240,
            "sparse.max_pairs": 6,
            "gate.kind": "greedy-oracle",
            "evaluation.gt_samples": 5000,
        }
    )
    result = run_photographs_mission(config, "ball", 0, tmp_path / "run")
    taken = result.metrics["taken"]
    assert result.status in ("ok", "degraded")
    assert len(taken) == len(set(taken)) == 18 == result.costs["images"]
    assert "target" not in result.message
    assert result.metric("observable.f_score_48mm") > 70.0
    assert result.provenance["fidelity"] == "photographs"
    assert result.provenance["flight_time"].startswith("nominal")
    assert (tmp_path / "run" / "cleaning.json").is_file()
    again = run_photographs_mission(config, "ball", 0, None, keep="summary")
    assert again.metrics == result.metrics
    # Of a metric that a plug-in brings later nothing is known: the same cloud is measured again.
    monkeypatch.setattr(plugins, "_registered", {})
    plugins.register("metrics", "nearest", NEAREST)
    measured = run_photographs_mission(config, "ball", 0, None, keep="summary")
    assert measured.metric("whole.nearest_mm") >= 0.0
    assert measured.metric("whole.f_score_48mm") == result.metric("whole.f_score_48mm")
