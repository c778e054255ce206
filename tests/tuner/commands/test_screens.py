"""What commands print: as JSON, and on a terminal; sets of photographs."""

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import fake_campaigns
import pytest
from photographed_ball import write_part_of_a_set

from tuner.campaign.campaign import Campaign, CampaignEvent
from tuner.campaign.settings import CampaignSettings
from tuner.commands import evaluate
from tuner.commands.campaign_display import event_line, mission_line
from tuner.commands.console import output
from tuner.comparison.plan import EvaluationPlan
from tuner.missions.job import Record, Trial
from tuner.problem.space_files import load_search_space


def shown(gatetune: Any, *command: Any) -> Any:
    return json.loads(gatetune.ok(*command, "--json"))


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    fake_campaigns.run(folder / "one", name="one").recommendation()
    fake_campaigns.run(folder / "two", name="two", rocks=("c",), budget=2, sampler="sobol")
    (folder / "broken").mkdir()
    (folder / "broken" / "campaign.yaml").write_text("format: 0")
    return folder


def test_campaigns_are_listed_with_their_answers(gatetune, runs, monkeypatch):
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


SETTINGS: CampaignSettings = fake_campaigns.settings(space=load_search_space("gate_and_weights"))


def event(kind: Any = "finished", raw: float = 81.234, directory: Path = Path("d")) -> CampaignEvent:
    values = dict.fromkeys(SETTINGS.space.paths, 0.123456)
    record = Record(directory=directory, status="ok", wall_s=13.0)
    trial = Trial(number=11, values=values, rock="a", replicate=1, raw=raw, record=record)
    return CampaignEvent(kind, 2.0, 3, 9, trial)


def test_an_event_is_one_json_object() -> None:
    tree = json.loads(event_line(event(raw=float("nan"))))
    assert tree["event"] == "finished" and tree["mission"] == 11 and tree["budget"] == 9
    assert mission_line(event(), SETTINGS).startswith("#0011 a ")  # as in missions/0011_a_r1
    assert tree["value"] is None and set(tree["values"]) == set(SETTINGS.space.paths)


def test_confirm_flies_both_with_replicates_nobody_has_flown(gatetune, tmp_path, monkeypatch):
    space = load_search_space("gate")
    run = fake_campaigns.run(tmp_path / "run", space=space, sampler="sobol", budget=8, replicates=2)
    plans: list[EvaluationPlan] = []
    monkeypatch.setattr(evaluate, "run_and_report", lambda planned, *_: plans.append(planned.plan))
    found = run.recommendation()
    kept = replace(found, values=found.default_values)
    monkeypatch.setattr(Campaign, "recommendations", lambda *_, **__: {kept.name: kept})
    assert "there is nothing to confirm" in gatetune.ok("confirm", run.directory) and not plans
    trials = run.trials()
    better = replace(found, values=dict(trials[-1].values))
    monkeypatch.setattr(Campaign, "recommendations", lambda *_, **__: {better.name: better})
    # As where the recommendation had run all replicates and got fresh ones.
    monkeypatch.setattr(Campaign, "trials", lambda _: [replace(trials[0], replicate=6), *trials])
    gatetune.ok("confirm", run.directory, "--rock", "a", "--replicates", 3)
    (plan,) = plans
    assert {found.name, "hyb-h", "orbit"} <= set(plan.strategies) and plan.rocks == ("a",)
    assert {job.replicate for job in plan.jobs(tmp_path)} == {7, 8, 9}
    assert "was not tuned on 'elsewhere'" in gatetune.refused("confirm", run.directory, "--rock", "elsewhere")


def test_ctrl_c_while_it_loads_shows_no_traceback(tmp_path: Path) -> None:
    (tmp_path / "typer.py").write_text("import time; print('loading', flush=True); time.sleep(60)")
    path = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    command = subprocess.Popen(
        [sys.executable, "-m", "tuner.cli", "doctor"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
        # A shell's background job, such as `make test &`, ignores it, and so would its children.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert command.stdout is not None and command.stdout.readline() == "loading\n"
    command.send_signal(signal.SIGINT)
    assert command.communicate(timeout=60) == ("", "") and command.returncode == -signal.SIGINT


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GATETUNE_HOME", str(tmp_path))
    return tmp_path


def test_sets_are_listed(gatetune) -> None:
    write_part_of_a_set()
    listed = shown(gatetune, "photographs", "list")
    assert [(s["name"], s["registered"], s["photographs"]) for s in listed] == [("mine", 6, 7)]
    assert listed[0]["height_m"] == pytest.approx(0.368)
    assert listed[0]["weak"][0].startswith("azimuth 60°")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("enough yours", "no set of photographs 'yours'"),
        ("import . --name mine", "already a set 'mine'"),
        ("import . --name Mine!", "'Mine!' cannot name a set of photographs"),
        ("import . --name yours --max-size 7", "max_size is 7"),
        ("import . --name yours --metres-per-unit 1", "--metres-per-unit is of the model"),
        ("import . --name yours --model m --metres-per-unit 0", "metres_per_unit is 0"),
        ("import . --name yours --height-m 0", "height_m is 0"),
    ],
)
def test_mistakes(gatetune, arguments: str, words: str) -> None:
    write_part_of_a_set()
    assert words in gatetune.refused("photographs", *arguments.split())
