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
import typer

from tuner.campaign.begin import begin_campaign
from tuner.campaign.campaign import Campaign, CampaignEvent
from tuner.campaign.settings import CampaignSettings
from tuner.cli import app
from tuner.commands import evaluate
from tuner.commands.campaign_display import CampaignProgress, event_line, expected_s, mission_line
from tuner.comparison.plan import EvaluationPlan
from tuner.missions.job import Record, Trial
from tuner.missions.registry import mission_kind
from tuner.problem.space_files import load_search_space

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


def test_before_anything_runs_it_is_said_how_many_and_how_long_and_then_how_far(tmp_path: Path) -> None:
    asked = fake_campaigns.settings(fidelity="photogrammetric", rocks=("slab",))
    ours = begin_campaign(tmp_path / "ours", asked)
    config, rendered_s = ours.settings.problem.base, mission_kind("photogrammetric").seconds
    assert expected_s(ours, 2) == pytest.approx(rendered_s(config) * 9 / 2)
    longer = config.with_values({"photographs": 64})
    assert rendered_s(longer) == pytest.approx(2 * rendered_s(config))  # 64 photographs, and 32
    progress = CampaignProgress(SETTINGS)
    progress(replace(event("launched", directory=tmp_path / "m"), finished=0, elapsed_s=0.4))
    (tmp_path / "m").mkdir()
    (tmp_path / "m" / "progress.txt").write_text("11/32\n12/32\n")
    assert progress.description() == "0/9, runs a r1 (photograph 12/32)"


def test_confirm_flies_both_with_replicates_nobody_has_flown(
    gatetune: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_every_command_shows_an_example() -> None:
    def leaves(command: Any, path: str) -> list[str]:
        if hasattr(command, "commands"):
            return [x for name, c in command.commands.items() for x in leaves(c, f"{path} {name}")]
        return [] if f"Example: {path}" in str(command.help) else [path]

    assert leaves(typer.main.get_command(app), "gatetune") == []


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
