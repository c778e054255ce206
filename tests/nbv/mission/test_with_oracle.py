"""What an oracle would have gained is recorded where it is asked for, and changes nothing else."""

import pytest

from nbv.config import preset
from nbv.geometric import run_geometric_mission
from nbv.photogrammetric import run_photogrammetric_mission

CONFIG = preset("campaign").with_values({"stop.adaptive_budget": 1, "evaluation.gt_samples": 5000})


@pytest.mark.parametrize(
    "fly", [run_geometric_mission, pytest.param(run_photogrammetric_mission, marks=pytest.mark.slow)]
)
def test_only_a_mission_that_asks_hears_the_oracle(fly):
    plain, asked = fly(CONFIG, "boulder"), fly(CONFIG, "boulder", with_oracle=True)
    assert [record.oracle_rewards for record in plain.trace] == [{}]
    assert all(set(record.oracle_rewards) == {"covis", "b-aware"} for record in asked.trace)
    assert [r.chosen for r in plain.trace] == [r.chosen for r in asked.trace]
    assert plain.metrics == asked.metrics


def test_an_oracle_gate_hears_it_unasked():
    result = run_geometric_mission(CONFIG.with_values({"gate.kind": "hyb-o"}), "boulder")
    assert set(result.trace[0].gate_details["oracle_rewards"]) == {"covis", "b-aware"}
