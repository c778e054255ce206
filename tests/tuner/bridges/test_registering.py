"""Our scorer in a registry like theirs: it ranks as `nbv.Planner` does, with weights that their files cannot say."""

import dataclasses
import math
import types

import numpy as np
import pytest
import yaml
from colmap_workspace import write_workspace

from nbv import Planner
from nbv.config import preset
from nbv.errors import UserError
from nbv.viewpoints import candidate_pool, seed_viewpoints
from tuner.bridges.photogrammetry_nbv import node
from tuner.bridges.photogrammetry_nbv.registering import NAME, register
from tuner.bridges.photogrammetry_nbv.workspace import best_model, sparse_model

# What each scorer is told and answers (upstream_bridge.md; scoring_interface.py and contracts.py of b8e106c).
Candidate = dataclasses.make_dataclass(
    "Candidate", ["candidate_id", "x", "y", "z", "yaw", "elevation_rad", "extra"]
)
Breakdown = dataclasses.make_dataclass(
    "Breakdown", ["candidate_id", "final_score", "terms", "weights", "scorer_name"]
)
ROCK = np.array([0.0, 8.0, -0.8])


class BaseScorer:
    def __init__(self, config):
        self.config = config


def ned(enu):
    east, north, up = enu
    return ROCK + np.array((north, east, 0.8 - up))


@pytest.fixture
def flight(tmp_path):
    """24 seeds and one more view over a made-up sparse model, in their words; and the same for our planner."""
    config = preset("paper").with_values(
        {"b_aware.weights.nov": 0.07, "covis.weights.nov": 0.4, "gate.kind": "b-aware"}
    )
    views = [np.array(v.position_m) for v in seed_viewpoints(config)]
    pool = candidate_pool(config, views[-1], np.zeros((0, 3)))
    views.append(pool.positions_m[30])
    write_workspace(tmp_path, views)
    visited = [
        {
            "position_ned_m": dict(zip("xyz", ned(at))),
            "image_file": f"{i:02d}.jpg",
            "source": "seed" if i <= 24 else "adaptive",
        }
        for i, at in enumerate(views, 1)
    ]
    context = types.SimpleNamespace(
        current_position_xyz=list(ned(views[-1])),
        current_yaw_rad=0.3,
        rock_center_xyz=list(ROCK),
        visited_viewpoints=visited,
        image_budget=40,
        images_used=1,
        current_iteration=1,
        colmap_workspace=str(tmp_path),
    )
    reported = {f"{i:02d}.jpg": at for i, at in enumerate(views, 1)}
    plan = Planner(config).plan(
        sparse_model(best_model(tmp_path), reported), np.array(views), 24, views[-1], math.pi / 2 - 0.3
    )
    assert plan.pool is not None
    candidates = [
        Candidate(name, *ned(at), math.pi / 2 - heading, math.radians(el), {"planner_band": band})
        for name, at, heading, el, band in zip(
            plan.pool.ids,
            plan.pool.positions_m,
            plan.pool.headings_rad,
            plan.pool.elevations_deg,
            plan.pool.bands,
        )
    ]
    (tmp_path / "gatetune.yaml").write_text(yaml.safe_dump(config.to_dict()))
    return tmp_path, candidates, context, plan


def registered():
    registry = {"covisibility": object}
    register(registry, BaseScorer, Breakdown)
    assert issubclass(registry[NAME], BaseScorer)
    return registry[NAME]


def test_it_ranks_as_our_planner_does(flight, monkeypatch):
    folder, candidates, context, plan = flight
    scorer = registered()({"name": NAME, "gatetune_config": str(folder / "gatetune.yaml")})
    scores = scorer.score_candidates(candidates, None, context)
    assert [s.candidate_id for s in scores] == [view.id for view in plan.views]
    assert scores[0].scorer_name == "gatetune:b-aware" and len(scores) == len(candidates)
    np.testing.assert_allclose(scores[0].final_score, plan.decision.ranking.scores.max(), rtol=1e-9)


def test_the_environment_may_name_the_configuration(flight, monkeypatch):
    with pytest.raises(UserError, match=r"name a gatetune\.yaml"):
        registered()({"name": NAME})
    monkeypatch.setenv("GATETUNE_CONFIG", str(flight[0] / "gatetune.yaml"))
    assert registered()({"name": NAME}).planner._config.b_aware.weights.nov == 0.07


def test_the_node_is_run_with_it_and_ends(monkeypatch, flight):
    """Their main() ends on Ctrl-C alone; the controller's timer calls ``_run`` (upstream_bridge.md, traps)."""
    registry, seen = {}, []

    class UnifiedControllerNode:
        state = types.SimpleNamespace(name="SCORE_NEXT_VIEW")

        def _run(self):
            seen.append(self.state.name)
            self.state = types.SimpleNamespace(name="FINISHED" if len(seen) == 2 else "LAND")

    def main():
        timer = UnifiedControllerNode()
        with pytest.raises(KeyboardInterrupt):
            while True:
                timer._run()

    modules = {
        "scorers": {"SCORER_REGISTRY": registry},
        "scoring_interface": {"BaseScorer": BaseScorer},
        "contracts": {"ScoreBreakdown": Breakdown},
        "unified_controller_node": {"UnifiedControllerNode": UnifiedControllerNode, "main": main},
    }
    monkeypatch.setitem(
        __import__("sys").modules, "photogrammetry_nbv", types.ModuleType("photogrammetry_nbv")
    )
    for name, content in modules.items():
        module = types.ModuleType(f"photogrammetry_nbv.{name}")
        vars(module).update(content)
        monkeypatch.setitem(__import__("sys").modules, module.__name__, module)
    node.main()
    assert NAME in registry and seen == ["SCORE_NEXT_VIEW", "LAND"]
