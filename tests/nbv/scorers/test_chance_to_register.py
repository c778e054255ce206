"""The chance to register: it falls with the angle to what is registered, makes a floor and a term, and bridges gaps."""

import numpy as np
import pytest
from scoring_state import pool_at, sparse_model

from nbv.config import MissionConfig
from nbv.gates import bridge
from nbv.planner import Planner
from nbv.scorers import rank_candidates
from nbv.scorers.registration import registrable, registration_chance, unregistered_m
from nbv.types import PlanningState
from nbv.viewpoints import ViewpointSource

TARGET_M = np.array(MissionConfig().target_m)
CAMERAS_DEG = np.arange(0.0, 121.0, 20.0)
POOL_DEG = np.arange(10.0, 351.0, 10.0)


def at(azimuths_deg):
    azimuth = np.deg2rad(np.asarray(azimuths_deg, dtype=float))
    return TARGET_M + 3.5 * np.column_stack([np.cos(azimuth), np.sin(azimuth), np.full(len(azimuth), 0.3)])


def state(lost_deg=()):
    """Points on a ball, each seen by the registered cameras on its side; the photographs at ``lost_deg`` are not registered."""
    normals = np.random.default_rng(0).normal(size=(2000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    cameras = at(CAMERAS_DEG)
    seen = [np.flatnonzero((cameras - TARGET_M) @ n > 1.0) for n in normals]
    kept = [k for k, s in enumerate(seen) if len(s) >= 2]
    model = sparse_model(TARGET_M + 0.6 * normals[kept], [seen[k] for k in kept], cameras)
    visited = np.concatenate([cameras, at(lost_deg)])
    return PlanningState(model, visited, len(visited), cameras[-1], 0.0, 0, 8, 0.1, 0)


class Anywhere(ViewpointSource):
    def candidates(self, config, vehicle_position_m, visited_m, n_seeds):
        return pool_at(at(POOL_DEG), TARGET_M)


def planned(given, **values):
    config = MissionConfig().with_values({"stop.criterion": "budget", "gate.kind": "b-aware", **values})
    return Planner(config, viewpoints=Anywhere()).plan(
        given.model, given.visited_m, 3, given.vehicle_position_m, 0.0
    )


def azimuth_deg(plan):
    return float(POOL_DEG[plan.decision.ranking.top])


def test_the_chance_falls_with_the_angle_to_what_is_registered():
    chance = registration_chance(state().model, at([120.0, 140.0, 160.0, 200.0]), MissionConfig())
    assert chance[0] > 0.8 and (np.diff(chance) < 0).all() and chance[-1] < 0.2


def test_a_candidate_below_the_floor_is_not_flown_and_the_likeliest_is_left():
    given = state()
    chance = registration_chance(given.model, at(POOL_DEG), MissionConfig())
    assert chance[int(planned(given).decision.ranking.top)] < 0.8  # novelty goes where little matches
    kept = planned(given, **{"pool.min_register_chance": 0.8})
    assert len(kept.pool) == kept.pool.counts["registrable"] == (chance >= 0.8).sum() < len(POOL_DEG)
    far = pool_at(at([180.0, 240.0, 210.0]), TARGET_M)
    config = MissionConfig().with_values({"pool.min_register_chance": 1.0})
    assert registrable(far, given.model, config).ids == ("cand_000",)


def test_the_chance_is_a_term_with_its_weight():
    given, pool = state(), pool_at(at(POOL_DEG), TARGET_M)
    config = MissionConfig().with_values({"b_aware.weights.register": 2.0})
    plain, weighed = (rank_candidates(given, pool, c)["b-aware"] for c in (MissionConfig(), config))
    assert "register" not in plain.terms
    np.testing.assert_allclose(weighed.scores - plain.scores, 2.0 * weighed.terms["register"])


@pytest.mark.parametrize("lost", [(170.0,), (170.0, 190.0)])  # a photograph, or a part of the seeds
def test_what_is_not_registered_is_bridged(lost):
    given = state(lost)
    np.testing.assert_allclose(unregistered_m(given), at(lost))
    assert planned(given).decision.ranking.scorer == "b-aware"
    assert (
        planned(given, **{"gate.bridge_below": 0.5}).decision.ranking.scorer == "b-aware"
    )  # enough are registered
    plan = planned(given, **{"gate.bridge_below": 1.0})
    assert plan.decision.ranking.scorer == "bridge" and 120.0 < azimuth_deg(plan) < 170.0
    assert (
        planned(given, **{"gate.bridge_below": 1.0, "gate.kind": "random"}).decision.ranking.scorer
        == "random"
    )


def test_nothing_is_bridged_where_no_view_comes_nearer():
    config = MissionConfig().with_values({"gate.bridge_below": 1.0})
    given, pool = (
        state((62.0,)),
        pool_at(at(POOL_DEG), TARGET_M),
    )  # among registered ones: another view would not help
    assert bridge(given, pool, rank_candidates(given, pool, config), config) is None
