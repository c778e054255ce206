"""``--json``: what a command shows as one document, and nothing else."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import tuner
from nbv.config import MissionConfig, preset
from nbv.rocks import list_rocks
from tuner.commands import doctor
from tuner.commands.doctor import Finding


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


def test_a_machine_that_is_not_fit_is_said(gatetune: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "CHECKS", (lambda: iter([Finding("bad", "no Python", "make setup")]),))
    for check in doctor.CHECKS:
        check.__name__ = "check"
    code, out, _ = gatetune("doctor", "--json")
    assert code == 1
    assert json.loads(out) == {
        "fit": False,
        "findings": [{"verdict": "bad", "what": "no Python", "remedy": "make setup"}],
    }


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> tuner.Campaign:
    return tuner.tune(
        tmp_path_factory.mktemp("json") / "first",
        rocks=["slab"],
        space="gate",
        budget=3,
        overrides={"stop.adaptive_budget": 2, "evaluation.gt_samples": 2000},
        sampler="sobol",
        fidelity="geometric",
        learn_from=["nothing"],
        workers=1,
    )


def test_status_is_the_campaigns(gatetune: Any, campaign: tuner.Campaign) -> None:
    best = campaign.recommendation(save=False)
    assert best is not None
    tree = shown(gatetune, "campaign", "status", campaign.directory)
    assert (tree["status"]["complete"], tree["status"]["budget"]) == (3, 3)
    assert tree["recommendation"]["values"] == best.values
    assert tree["recommendation"]["improvement_interval_95"] == list(best.improvement_interval_95)


def test_a_table_says_where_it_is(gatetune: Any, campaign: tuner.Campaign, tmp_path: Path) -> None:
    tree = shown(gatetune, "export", campaign.directory, "--to", "csv", "--out", tmp_path / "m.csv")
    assert len(Path(tree["wrote"]).read_text().splitlines()) == 1 + 3
