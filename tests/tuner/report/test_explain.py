"""``gatetune mission explain`` of a mission's decisions."""

from __future__ import annotations

import json
import re
from pathlib import Path

from nbv.config import preset
from nbv.geometric import run_geometric_mission


def test_a_gates_decisions_and_what_would_have_switched(gatetune, tmp_path: Path) -> None:
    config = preset("campaign").with_values(
        {
            "stop.adaptive_budget": 4,
            "gate.budget_fraction": 0.5,
            "gate.d95_m": 0.249,
            "evaluation.gt_samples": 2000,
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
        assert f"step {step['step']}: {record.scorer} chose {record.chosen}, since {step['why']}" in text
        needed = re.findall(
            r"gate\.(\w+) (of at most|of at least|above|below) ([\d.]+)", step["would_switch"]
        )
        nudge = {"above": 1e-4, "below": -1e-4}
        found = {name: float(value) + nudge.get(how, 0) for name, how, value in needed}
        other = {"covis": "b-aware", "b-aware": "covis"}[record.scorer]
        assert step["would_switch"].startswith(f"{other} would have flown")
        for tried in [found] if record.scorer == "b-aware" else [{k: v} for k, v in found.items()]:
            at = {"budget_fraction": 0.5, "d95_m": 0.249, **tried}
            early, coarse = record.gate_details["f_b"] < at["budget_fraction"], record.d95_m > at["d95_m"]
            assert ("b-aware" if early or coarse else "covis") == other
