"""A mission explained, shown to walk around in, and the pages in a browser."""

import base64
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from nbv.cache import Store
from nbv.config import preset
from nbv.errors import UserError
from nbv.geometric import run_geometric_mission
from nbv.geometry.mesh import sample_surface
from nbv.geometry.ply import write_ply
from nbv.rocks import load_rock
from nbv.types import PointCloud
from tuner.report import write_mission_view
from tuner.report.mission_view import STEP_M

BUDGET = 2


@pytest.fixture(scope="module")
def mission(tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = tmp_path_factory.mktemp("run") / "first"
    config = preset("campaign").with_values({"photographs": 24 + BUDGET})
    result = run_geometric_mission(config, "slab", 0, run)
    for event in json.loads((run / "flight.json").read_text())["events"]:
        if event["name"].startswith(("seed", "cand")):
            Image.fromarray(np.full((48, 64, 3), 90, np.uint8)).save(run / "images" / f"{event['name']}.png")
    assert result.status == "ok"
    return run


def shown(page: Path) -> list[dict]:
    data = r'<script type="application/json" id="data">(.*?)</script>'
    return json.loads(re.search(data, page.read_text(), re.DOTALL)[1])


def points(facts: dict, packed: str) -> np.ndarray:
    steps = np.frombuffer(base64.b64decode(packed), "<i2").reshape(-1, 3)
    return np.array(facts["origin"]) + STEP_M * steps


def test_the_slider_goes_over_every_capture(mission: Path, tmp_path: Path) -> None:
    page = write_mission_view([mission], tmp_path / "view.html")
    (facts,) = shown(page)
    trace = json.loads((mission / "mission.json").read_text())["trace"]
    assert [step["views"] for step in facts["steps"]] == [*range(1, 25), 24, 25, 26]
    decisions = facts["steps"][24 : 24 + BUDGET]
    for step, record in zip(decisions, trace, strict=True):
        said = dict(step["facts"])
        assert (said["scorer"], said["reason"]) == (record["scorer"], record["reason"])
        assert step["label"].endswith(record["chosen"])
        chosen = facts["views"][step["views"]]
        assert chosen["name"] == record["chosen"] and chosen["at"] in step["pool"]
        assert len(points(facts, facts["models"][step["model"]]["p"])) == record["n_points"]
    assert all(view["image"] for view in facts["views"])
    f_score = json.loads((mission / "mission.json").read_text())["metrics"]["observable"]["f_score_48mm"]
    assert facts["headline"] == f"{24 + BUDGET} photographs, F-score {f_score:.1f} % at 48 mm"
    text = page.read_text()
    assert not re.search(r"https?://|src=\"(?!data:|\$)|<link", text)  # it needs nothing else
    assert len(text) < 15e6


def test_what_is_missing_of_the_truth_is_told(mission: Path, tmp_path: Path) -> None:
    half = Path(shutil.copytree(mission, tmp_path / "half"))
    rock = load_rock("slab", Store())
    surface, _ = sample_surface(rock.vertices_m, rock.faces, 20_000, 1)
    write_ply(half / "cleaned.ply", PointCloud(surface[surface[:, 0] > 0]))
    (facts,) = shown(write_mission_view([half], tmp_path / "b.html"))
    missing = points(facts, facts["missing"]["p"])
    assert len(missing) > 100 and missing[:, 0].max() < 0.0  # nothing of the half that is there


def test_another_rock_is_refused(mission: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    shutil.copytree(mission, other)
    result = json.loads((other / "mission.json").read_text())
    result["provenance"]["rock_sha256"] = "0" * 64
    (other / "mission.json").write_text(json.dumps(result))
    with pytest.raises(UserError, match=r"run on another 'slab' than the one found now.*--rock"):
        write_mission_view([other], tmp_path / "view.html")


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
