"""``gatetune mission explain`` of a mission's decisions."""

from __future__ import annotations

import json
from pathlib import Path

from nbv.config import preset
from nbv.geometric import run_geometric_mission


def test_a_gates_decisions_beside_its_thresholds(gatetune, tmp_path: Path) -> None:
    config = preset("campaign").with_values(
        {
            "stop.adaptive_budget": 4,
            "gate.budget_fraction": 0.5,
            "gate.d95_m": 0.249,
        }
    )
    trace = run_geometric_mission(config, "slab", 0, tmp_path / "m").trace
    code, out, err = gatetune("mission", "explain", tmp_path / "m", "--json")
    assert code == 0, err
    steps = json.loads(out)["steps"]
    assert [step["scorer"] for step in steps] == [record.scorer for record in trace]
    assert {step["scorer"] for step in steps} == {"covis", "b-aware"}  # both sides of the gate are seen
    text = gatetune("mission", "explain", tmp_path / "m")[1]
    for step, record in zip(steps, trace):
        assert (
            f"step {step['iteration'] + 1}: {record.scorer} chose {record.chosen}, since {step['reason']}"
            in text
        )
        assert step["gate_details"]["f_b"] == record.gate_details["f_b"] and step["top"] == record.top
    assert "gate.budget_fraction 0.5, gate.d95_m 0.249 m" in text
