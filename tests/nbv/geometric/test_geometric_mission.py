"""Geometric missions and their simulated stages."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from nbv.cache import code_digest
from nbv.config import DenseConfig, preset
from nbv.geometric import run_geometric_mission
from nbv.geometric.world import WORLDS, Tracks
from nbv.geometry.stereo_chance import reconstruction_probability
from nbv.mission.result import MissionResult
from nbv.mission.run_directory import RunDirectory, state_file, state_files
from nbv.rocks.catalogue import LOADED
from nbv.viewpoints import raw_candidates

ROCK = "boulder-7"
BUDGET = 3


@pytest.fixture(scope="module")
def config():
    return preset("campaign").with_values({"photographs": 24 + BUDGET})


@pytest.fixture(scope="module")
def finished(config):
    return run_geometric_mission(config, ROCK)


def same(a, b):
    return (
        a.trace == b.trace and a.metrics == b.metrics and {**a.costs, "wall_s": 0} == {**b.costs, "wall_s": 0}
    )


def test_the_mission_runs_the_loop_and_says_what_it_is(finished, config):
    assert (finished.status, finished.reason) == ("ok", "")
    assert finished.costs["images"] == finished.costs["registered_images"] == 24 + BUDGET
    assert finished.costs["flight_time_s"] > 60
    legal = {v.id for v in raw_candidates(config)}
    chosen = [record.chosen for record in finished.trace]
    assert len(chosen) == len(set(chosen)) == BUDGET
    assert set(chosen) <= legal
    assert finished.provenance["fidelity"] == finished.metrics["fidelity"] == "geometric"
    assert finished.provenance["geometric_code"] == code_digest("nbv.geometric")
    for surface in ("observable", "whole"):
        scores = [finished.metric(f"{surface}.completeness_{t}mm") for t in (16, 32, 48, 64, 80)]
        assert scores == sorted(scores)
        assert 0 < scores[0] <= scores[-1] <= 100
    assert finished.metric("observable.completeness_48mm") > finished.metric("whole.completeness_48mm")
    assert np.isfinite(finished.metric("observable.f_score_48mm"))


@pytest.mark.slow
def test_configuration_rock_and_replicate_determine_a_mission(finished, config, tmp_path, monkeypatch):
    run_geometric_mission(config, ROCK, 1)
    run_geometric_mission(config.with_values({"gate.kind": "random"}), ROCK)
    assert same(run_geometric_mission(config, ROCK), finished)  # from the memories in this process
    WORLDS.clear()
    assert same(run_geometric_mission(config, ROCK), finished)  # from the store
    WORLDS.clear()
    assert not same(run_geometric_mission(config, ROCK, 1), finished)
    WORLDS.clear()
    LOADED.clear()
    monkeypatch.setenv("GATETUNE_HOME", str(tmp_path / "home"))
    assert same(run_geometric_mission(config, ROCK, cache=False), finished)  # from nothing
    assert not (tmp_path / "home").exists()  # and nothing was kept


def test_a_run_directory_holds_a_result_and_is_not_overwritten(tmp_path, config):
    result = run_geometric_mission(config, ROCK, 0, tmp_path / "run")
    assert MissionResult.load(tmp_path / "run").to_json() == result.to_json()
    refused("already holds a finished mission", run_geometric_mission, config, ROCK, 0, tmp_path / "run")
    (tmp_path / "run/cleaning.json").touch()
    for number in range(BUDGET, 101):
        state_file(tmp_path / "run", number).touch()
    assert state_files(tmp_path / "run") == [state_file(tmp_path / "run", k) for k in range(101)]
    RunDirectory(tmp_path / "run", overwrite=True)  # and then it is interrupted
    assert {path.name for path in (tmp_path / "run").iterdir()} == {"config.yaml", "images", "states"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("numbers", "ground_features", "status"),
    [([12, 4], 0, "failed"), ([16], 0, "ok"), ([8], 2000, "ok")],
)
def test_seeds_that_sift_cannot_hold_together_fail(config, numbers, ground_features, status):
    """As photogrammetry has it on the boulder."""
    seeds, elevations_deg = sum(numbers), [20.0] if len(numbers) == 1 else [10.0, 75.0]
    ring = {"seeds": seeds, "seed.ring_elevations_deg": elevations_deg, "seed.ring_azimuth_counts": numbers}
    few = {**ring, "sparse.min_registered_seeds": 6, "sparse.ground_features": ground_features}
    few["photographs"] = seeds + 8
    result = run_geometric_mission(config.with_values(few), "boulder")
    assert (result.status, result.reason) == (status, "seed_model_failed" if status == "failed" else "")


def test_planning_in_the_air_costs_time_and_energy_alone() -> None:
    config = preset("campaign").with_values({"photographs": 27})
    without = run_geometric_mission(config, ROCK, 0, None)
    waiting = run_geometric_mission(config.with_values({"flight.planning_s": 4.0}), ROCK, 0, None)
    assert waiting.costs["flight_time_s"] == pytest.approx(without.costs["flight_time_s"] + 3 * 4.0)
    assert waiting.costs["energy_wh"] > without.costs["energy_wh"] > 1.0
    assert waiting.metrics == without.metrics


def test_seeds_alone_are_a_mission(config):
    """And the paper's rings, if they are one, are the same orbit as one turn."""
    orbit = {"photographs": 20, "seeds": 20, "seed.radius_m": 3.5, "sparse.ground_features": 2000}
    rings = {"seed.ring_elevations_deg": [10.0], "seed.ring_azimuth_counts": [4]}
    turn = {"seed.layout": "turn", "seed.lowest_deg": 10.0}
    a, b = (run_geometric_mission(config.with_values(orbit | way), ROCK) for way in (rings, turn))
    assert (a.status, a.trace, a.costs["images"]) == ("ok", [], 20)
    assert a.metrics == b.metrics


def test_the_same_photographs_have_the_same_score_whatever_the_pool_and_a_small_box(config):
    seeds = config.with_values({"photographs": 24})
    other = {"pool.radius_m": 2.5, "pool.lateral_elevations_deg": [20.0], "pool.upper_elevations_deg": [60.0]}
    box = {"shared.box_half_extent_m": 0.5}  # of the scorers
    a, b, c = (run_geometric_mission(seeds.with_values(values), ROCK) for values in ({}, other, box))
    assert a.metrics == b.metrics == c.metrics and c.status == "ok"


DENSE = DenseConfig(agreeing_views=3)


def fan(angles_deg):
    a = np.deg2rad(np.asarray(angles_deg, dtype=float))
    return np.column_stack([np.sin(a), np.zeros(len(a)), np.cos(a)])


def probability(angles_deg, seen=None, incidence_deg=0.0, contrast=0.05, dense=DENSE):
    n = len(angles_deg)
    seen = np.ones((n, 1), dtype=bool) if seen is None else seen
    incidence = np.broadcast_to(np.asarray(incidence_deg, dtype=float), seen.shape)
    texture = np.full(seen.shape[1], contrast)
    return reconstruction_probability(seen, incidence, texture, fan(angles_deg), dense)


def test_enough_close_views_reconstruct_and_too_few_do_not():
    assert probability([0, 8, 16, 24, 32, 40, 48])[0] > 0.9
    assert probability([0, 10], dense=DenseConfig(agreeing_views=6))[0] < 0.1  # two can agree, six must
    assert probability([0])[0] == 0.0


def test_grazing_views_and_faint_texture_reconstruct_less():
    views = [0, 8, 16, 24, 32, 40]
    by_incidence = [probability(views, incidence_deg=a)[0] for a in (0.0, 50.0, 70.0, 85.0)]
    assert all(a > b for a, b in pairwise(by_incidence)) and by_incidence[-1] < 0.5
    by_contrast = [probability(views, contrast=c)[0] for c in (0.05, 0.005, 0.0005, 0.0)]
    assert all(a > b for a, b in pairwise(by_contrast)) and by_contrast[-1] == 0.0


@settings(max_examples=40)
@given(st.integers(0, 10_000), st.integers(1, 9), st.integers(1, 12))
def test_tracks_are_the_connected_components_of_matches(seed, n_views, n_landmarks):
    rng = np.random.default_rng(seed)
    directions = rng.normal((0.0, 0.0, 1.5), 1.0, (n_views, n_landmarks, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    detected = rng.random((n_views, n_landmarks)) < 0.7
    limit = np.cos(rng.uniform(0.2, 1.2, n_landmarks))
    tracks = Tracks(limit, n_views)
    for view in range(n_views):
        tracks.add(np.flatnonzero(detected[view]), directions[view, detected[view]])
    landmarks, offsets, of_views = tracks.points(2)
    found = [
        (landmark, frozenset(of_views[a:b].tolist()))
        for landmark, a, b in zip(landmarks.tolist(), offsets[:-1], offsets[1:])
    ]
    expected = set()
    for landmark in range(n_landmarks):
        views = np.flatnonzero(detected[:, landmark])
        rays = directions[views, landmark].astype(np.float32)
        linked = rays @ rays.T >= np.float32(limit[landmark])
        _, label = connected_components(coo_matrix(linked), directed=False)
        groups = [views[label == g] for g in np.unique(label)]
        expected |= {(landmark, frozenset(g.tolist())) for g in groups if len(g) >= 2}
    assert len(found) == len(expected) and set(found) == expected
