import json
from pathlib import Path

from nbv.config import preset
from nbv.geometric import run_geometric_mission


def test_a_gates_decisions_beside_its_thresholds(gatetune, tmp_path: Path) -> None:
    values = {"photographs": 28, "gate.budget_fraction": 0.5, "gate.d95_m": 0.249}
    config = preset("campaign").with_values(values)
    trace = run_geometric_mission(config, "slab", 0, tmp_path / "m").trace
    steps = json.loads(gatetune.ok("mission", "explain", tmp_path / "m", "--json"))["steps"]
    assert [step["scorer"] for step in steps] == [record.scorer for record in trace]
    assert {step["scorer"] for step in steps} == {"covis", "b-aware"}  # both sides of the gate are seen
    text = gatetune.ok("mission", "explain", tmp_path / "m")
    for step, record in zip(steps, trace):
        assert f"{record.scorer} chose {record.chosen}, since {step['reason']}" in text
        assert step["gate_details"]["f_b"] == record.gate_details["f_b"] and step["top"] == record.top
    assert "gate.budget_fraction 0.5, gate.d95_m 0.249 m" in text
