"""``gatetune campaign list``."""

from __future__ import annotations

import json
from pathlib import Path

import fake_campaigns
import pytest


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    fake_campaigns.run(folder / "one", name="one").recommendation()
    (folder / "broken").mkdir()
    (folder / "broken" / "campaign.yaml").write_text("format: 0")
    return folder


def test_campaigns_are_listed_with_their_answers(gatetune, runs: Path) -> None:
    code, out, err = gatetune("campaign", "list", runs, "--json")
    assert code == 0, err
    rows = {Path(row["directory"]).name: row for row in json.loads(out)}
    assert list(rows) == ["broken", "one"]
    assert rows["broken"]["answer"].startswith("cannot be read: ")
    assert (rows["one"]["finished"], rows["one"]["budget"]) == (9, 9)
    saved = json.loads((runs / "one" / "recommendation.json").read_text())
    assert rows["one"]["values"] == saved["values"] and f"{saved['mean']:.4g}" in rows["one"]["answer"]
    assert rows["one"]["objective"] == "f_score"
    shown = gatetune("campaign", "list", runs)[1]
    assert "9/9" in shown and "f_score" in shown


def test_a_folder_without_campaigns_is_one_line(gatetune, tmp_path: Path) -> None:
    code, _, err = gatetune("campaign", "list", tmp_path)
    assert code == 2 and "holds no campaign" in err and len(err.strip().splitlines()) == 1
