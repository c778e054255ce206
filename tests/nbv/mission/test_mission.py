"""One small end-to-end photogrammetric mission, and what its run directory promises."""

import json

import numpy as np
import pytest
from scene_helpers import SMALL_GROUND

from nbv.config import config_from_dict, preset
from nbv.geometry.ply import read_ply
from nbv.mission.result import MissionResult
from nbv.photogrammetric import run_photogrammetric_mission
from nbv.rocks.catalogue import LOADED

ROCK = "boulder"
SEEDS, BUDGET = 16, 2


@pytest.fixture(scope="module")
def config():
    return preset("campaign").with_values(
        {
            "photographs": SEEDS + BUDGET,
            "seeds": SEEDS,
            "seed.layout": "turn",
            "evaluation.gt_samples": 10_000,
            "dense.agreeing_views": 3,
            "dense.max_size_px": 320,
        }
    )


@pytest.fixture(scope="module", autouse=True)
def small_ground(tmp_path_factory):
    """And a home of its own, so that no other test meets these photographs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GATETUNE_HOME", str(tmp_path_factory.mktemp("home")))
        patch.setattr("nbv.scene.bake.GroundSpec", lambda: SMALL_GROUND)
        yield


@pytest.fixture(scope="module")
def finished(config, tmp_path_factory):
    directory = tmp_path_factory.mktemp("mission") / "run"
    lines = []
    result = run_photogrammetric_mission(config, ROCK, 0, directory, log=lines.append)
    return result, directory, lines


@pytest.mark.slow
def test_the_mission_reconstructs_the_rock(finished):
    result, _, lines = finished
    assert (result.status, result.reason) == ("ok", "")
    assert result.costs["images"] == result.costs["registered_images"] == SEEDS + BUDGET
    assert result.metric("observable.completeness_48mm") > 80
    assert result.metric("whole.c2c_median_mm") < 20
    assert result.metric("observable.accuracy_48mm") > 90
    assert lines[0].startswith("seed model")
    assert [line.split()[0] for line in lines[1:]] == ["capture"] * BUDGET


@pytest.mark.slow
def test_the_run_directory_holds_what_it_promises(finished, config):
    import pycolmap
    import yaml

    result, directory, _ = finished
    assert MissionResult.load(directory).to_json() == result.to_json()
    assert config_from_dict(yaml.safe_load((directory / "config.yaml").read_text())) == config
    assert len(list((directory / "images").glob("*.png"))) == SEEDS + BUDGET
    trace = [json.loads(line) for line in (directory / "trace.jsonl").read_text().splitlines()]
    assert [record["chosen"] for record in trace] == [record.chosen for record in result.trace]
    assert result.provenance["rock_sha256"]
    assert result.provenance["versions"]["pycolmap"]

    # The exported model opens in COLMAP and is in the world frame: cameras stand on the 4 m and 3.5 m spheres.
    model = pycolmap.Reconstruction(directory / "sparse" / "0")
    assert model.num_reg_images() == SEEDS + BUDGET
    for image in model.images.values():
        radius = np.linalg.norm(image.projection_center() - np.array([0, 0, 0.8]))
        expected = 4.0 if image.name.startswith("seed") else 3.5
        assert abs(radius - expected) < 0.35 * np.sqrt(3)

    dense, cleaned = (read_ply(directory / name)[0] for name in ("dense.ply", "cleaned.ply"))
    assert len(dense.points_m) > len(cleaned.points_m) > 1000
    assert abs(cleaned.points_m[:, 2].max() - 1.6) < 0.05  # the rock's height


@pytest.mark.slow
def test_cached_and_uncached_missions_are_bit_identical(finished, config, tmp_path, monkeypatch):
    result, directory, _ = finished  # filled the store
    again = run_photogrammetric_mission(config, ROCK, 0, tmp_path / "cached", cache=True)
    monkeypatch.setenv("GATETUNE_HOME", str(tmp_path / "home"))
    LOADED.clear()
    without = run_photogrammetric_mission(config, ROCK, 0, tmp_path / "uncached", cache=False)
    assert not (tmp_path / "home").exists()  # nothing was read or written
    for other in ("cached", "uncached"):
        assert (tmp_path / other / "dense.ply").read_bytes() == (directory / "dense.ply").read_bytes()
        assert (tmp_path / other / "sparse/0/points3D.bin").read_bytes() == (
            directory / "sparse/0/points3D.bin"
        ).read_bytes()
    assert again.metrics == without.metrics == result.metrics
