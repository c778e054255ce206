"""``--json``: what a command shows as one document, and nothing else."""

from __future__ import annotations

import json
from typing import Any

import pytest

from nbv.config import MissionConfig, preset
from nbv.rocks import list_rocks


def shown(gatetune: Any, *command: Any) -> Any:
    code, out, err = gatetune(*command, "--json")
    assert code == 0, err
    return json.loads(out)


def test_rocks_and_the_store(gatetune: Any) -> None:
    listed = shown(gatetune, "rocks", "list", "--split", "held-out")
    assert [r["name"] for r in listed] == [r.name for r in list_rocks() if r.split == "held-out"]
    assert shown(gatetune, "rocks", "show", "slab")["extents_m"][2] == pytest.approx(1.6)
    assert shown(gatetune, "cache", "info")["size_bytes"] > 0
    assert shown(gatetune, "cache", "verify")["damaged"] == 0


def test_a_configuration_and_its_metrics(gatetune: Any) -> None:
    tree = shown(gatetune, "config", "show", "--preset", "campaign", "--set", "gate.d95_m=0.2")
    rows = {row["path"]: row for row in tree["parameters"]}
    assert rows["gate.d95_m"]["value"] == 0.2 and rows["gate.d95_m"]["source"] == "--set"
    assert rows["stop.adaptive_budget"]["value"] == preset("campaign").stop.adaptive_budget
    assert rows["stop.adaptive_budget"]["source"].endswith("preset campaign")
    found = shown(gatetune, "metrics")
    assert "f_score_Tmm" in [metric["name"] for metric in found["metrics"]]
    assert tuple(found["thresholds_mm"]) == MissionConfig().evaluation.thresholds_mm
    assert found["short_names"]["photographs"] in found["costs"]
