"""The planner by itself: it decides as the mission did, and needs nothing that a vehicle does not carry."""

import subprocess
import sys

import pytest
import yaml
from refusals import refused

import nbv
from nbv.config import preset
from nbv.geometric import run_geometric_mission
from nbv.mission.planning_state import load_state

CODE = """
import sys, numpy as np, nbv
from nbv.config import preset
from nbv.types import SparseModel
rng = np.random.default_rng(0)
points = rng.normal([0.0, 0.0, 0.8], 0.4, (200, 3))
cameras = np.array([[4.0, 0.0, 2.0], [0.0, 4.0, 2.0], [-4.0, 0.0, 2.0]])
model = SparseModel(points, np.ones(200), np.arange(0, 601, 3), np.tile([0, 1, 2], 200), cameras, ("a", "b", "c"), 0.0, 0.0)
plan = nbv.Planner(preset("paper")).plan(model, cameras, 3, cameras[-1], 0.0)
assert len(plan.pool) > 100 and plan.next_view.id in plan.pool.ids, plan
print(*sorted({name.partition(".")[0] for name, module in sys.modules.items() if "Lazy" not in type(module).__name__}))
"""


def test_it_loads_no_open3d_pyrender_or_torch():
    ran = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    heavy = {"open3d", "pyrender", "torch", "cv2", "pycolmap", "skimage", "sklearn", "trimesh"}
    assert heavy & set(ran.stdout.split()) == set()


@pytest.mark.parametrize(("gate", "rock"), [("hyb-h", "slab"), ("predicted", "boulder-21")])
def test_alone_it_chooses_the_views_of_the_mission(gate, rock, tmp_path):
    config = preset("campaign").with_values({"photographs": 28, "gate.kind": gate})
    result = run_geometric_mission(config, rock, 0, tmp_path)
    (tmp_path / "tuned.yaml").write_text(yaml.safe_dump(config.to_dict()))
    # The size of a drawn rock is not known well: the mission's directory says what the vehicle was told.
    planner = nbv.Planner.from_yaml(tmp_path / ("tuned.yaml" if rock == "slab" else "located.yaml"))
    assert len(result.trace) == 4
    for record in result.trace:
        state, _ = load_state(tmp_path / "states" / f"iter_{record.iteration:02d}.npz")
        plan = planner.plan(
            state.model, state.visited_m, state.n_seeds, state.vehicle_position_m, state.vehicle_heading_rad
        )
        assert plan.next_view is not None and plan.decision is not None
        assert (plan.next_view.id, plan.decision.ranking.scorer) == (record.chosen, record.scorer)


def test_it_ends_where_the_cloud_is_dense_or_nothing_is_left_or_the_budget_is_used(tmp_path):
    config = preset("campaign").with_values({"photographs": 25})
    run_geometric_mission(config, "slab", 0, tmp_path)
    state, _ = load_state(tmp_path / "states" / "iter_00.npz")
    given = (state.model, state.visited_m, state.n_seeds, state.vehicle_position_m, 0.0)
    dense = config.with_values({"stop.criterion": "both", "stop.knn_threshold_m": 10.0})
    plan = nbv.Planner(dense).plan(*given)
    assert plan.converged and plan.next_view is None
    plan = nbv.Planner(config.with_values({"pool.max_travel_m": 0.001})).plan(*given)
    assert not plan.converged and plan.next_view is None and plan.pool is not None and len(plan.pool) == 0
    planner, (model, visited, seeds, at, heading) = nbv.Planner(config), given
    plan = planner.plan(model, visited, seeds - 1, at, heading)
    assert plan.next_view is None and not plan.converged and plan.end == "the budget of 1 is used"
    for wrong in (
        (seeds + 1, at, heading),
        (-1, at, heading),
        (seeds, at * float("nan"), heading),
        (seeds, at, float("inf")),
    ):
        refused(r"n_seeds|not finite", planner.plan, model, visited, *wrong)
