import json
from pathlib import Path
from typing import Any

import fake_campaigns
import pytest

from nbv.config import preset
from nbv.rocks import list_rocks
from tuner.commands.console import output


def shown(gatetune: Any, *command: Any) -> Any:
    return json.loads(gatetune.ok(*command, "--json"))


def test_rocks_and_the_machine(gatetune: Any) -> None:
    listed = shown(gatetune, "rocks", "list", "--split", "held-out")
    assert [r["name"] for r in listed] == [r.name for r in list_rocks() if r.split == "held-out"]
    assert shown(gatetune, "rocks", "show", "slab")["extents_m"][2] == pytest.approx(1.6)
    assert shown(gatetune, "doctor")["fit"]


def test_a_configuration(gatetune: Any) -> None:
    tree = shown(gatetune, "config", "show", "--preset", "campaign", "--set", "gate.d95_m=0.2")
    rows = {row["path"]: row for row in tree["parameters"]}
    assert rows["gate.d95_m"]["value"] == 0.2 and rows["gate.d95_m"]["source"] == "--set"
    assert rows["photographs"]["value"] == preset("campaign").photographs
    assert rows["photographs"]["source"].endswith("preset campaign")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    fake_campaigns.run(folder / "one", name="one").recommendation()
    fake_campaigns.run(folder / "two", name="two", rocks=("c",), budget=2, sampler="sobol")
    (folder / "broken").mkdir()
    (folder / "broken" / "campaign.yaml").write_text("format: 0")
    return folder


def test_campaigns_are_listed_with_their_answers(
    gatetune, runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = {Path(row["directory"]).name: row for row in shown(gatetune, "campaign", "list", runs)}
    assert list(rows) == ["broken", "one", "two"]
    assert rows["broken"]["answer"].startswith("cannot be read: ")
    assert (rows["one"]["finished"], rows["one"]["budget"]) == (9, 9)
    gatetune.ok("campaign", "status", runs / "one")
    assert "not computed yet" in rows["one"]["answer"]
    (runs / "two" / "answer.json").write_text('{"fly": 3')
    damaged = {Path(row["directory"]).name: row for row in shown(gatetune, "campaign", "list", runs)}["two"]
    assert damaged["budget"] == 2 and "cannot be read" not in damaged["answer"]
    again = {Path(row["directory"]).name: row for row in shown(gatetune, "campaign", "list", runs)}["one"]
    assert again["answer"].startswith("9 of 9 missions, tuned for f_score: fly ")
    monkeypatch.setattr(output, "width", 80)
    narrow = gatetune.ok("campaign", "list", runs).splitlines()
    assert "9 of 9 missions, tuned for f_score" in "\n".join(narrow)
    assert max(len(line) for line in narrow if not line.startswith("/")) <= 80 and "…" not in "".join(narrow)
