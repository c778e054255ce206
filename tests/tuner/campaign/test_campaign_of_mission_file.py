"""A campaign over a mission file, from the command line: everything that a campaign over our own missions has."""

import json

import pytest
import yaml

from tuner.campaign import Campaign

FLY = """
import math
def fly(request):
    c, away = request["configuration"], len(request["instance"]["name"])
    if c["gain"] > 3.9:
        return {"failure": {"of": "configuration", "reason": "tipped_over"}}
    return {"metrics": {"loss": (c["gain"] - away) ** 2 + (c["mode"] == "bad")}, "cost": {"fuel_kg": c["gain"]}}
"""
FILE = {
    "schema": "gatetune.mission/1",
    "name": "toy",
    "function": "toy_mission:fly",
    "parameters": {
        "gain": {"kind": "float", "low": 0, "high": 4, "default": 0},
        "mode": {"kind": "categorical", "choices": ["bad", "good"], "default": "bad"},
    },
    "instances": ["a", "bb"],
    "held_out": ["ccc"],
    "replicates": 2,
    "metric": "loss",
    "direction": "minimise",
    "baselines": {"hand": {"gain": 3}},
    "time_limit_s": 20,
}
RUN = ["campaign", "run", "--mission", "toy.yaml", "--sampler", "sobol", "--workers", 1]


@pytest.fixture
def toy(tmp_path):
    (tmp_path / "toy_mission.py").write_text(FLY)
    (tmp_path / "toy.yaml").write_text(yaml.safe_dump(FILE))
    return tmp_path


@pytest.mark.slow
def test_a_campaign_flies_reports_and_knows_its_file(gatetune, toy):
    code, out, err = gatetune(*RUN, "--budget", 5)
    assert code == 0, out + err
    assert "paper" not in out
    campaign = Campaign.open(toy / "runs/toy", read_only=True)
    trials = campaign.trials()
    assert [(t.rock, t.replicate) for t in trials[:4]] == [("a", 0), ("bb", 0), ("a", 1), ("bb", 1)]
    assert trials[0].values == {"gain": 0.0, "mode": "bad"} and trials[0].raw == 2.0
    page = (toy / "runs/toy/report.html").read_text()
    assert "toy.yaml" in page and "paper’s default" not in page and "gatetune mission run" not in page
    assert "What did the gate do" not in page and "simulated flight" not in page
    assert gatetune("campaign", "status", "runs/toy")[0] == 0

    assert "not ours" in gatetune("export", "runs/toy", "--to", "scoring.yaml")[2]

    (toy / "toy.yaml").write_text(yaml.safe_dump({**FILE, "time_limit_s": 30}))
    code, out, err = gatetune("campaign", "resume", "runs/toy", "--missions", 8)
    assert code == 2 and "has changed since the campaign began" in err and err.count("\n") == 1


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--mission", "nowhere.yaml"], "gatetune mission init"),
        (["--mission", "toy.yaml", "--space", "gate"], "--space is of our own missions"),
        (["--mission", "toy.yaml", "--condition", "field"], "--condition is of our own missions"),
        (["--mission", "toy.yaml", "--set", "gate.kind=covis"], "--set is of our own missions"),
        (["--mission", "toy.yaml", "--rock", "ccc"], "'ccc' is held out"),
        (["--mission", "toy.yaml", "--rock", "slab"], "'slab' is no instance"),
        (["--mission", "toy.yaml", "--learn-from", "shipped"], "no missions come with this program"),
        (["--fidelity", "external"], "name one with --mission"),
        (["settings.yaml"], "if you trust it, name it: --mission toy.yaml"),
        (["--metric", "observable.f_score_49mm"], "did you mean observable.f_score_"),
    ],
)
def test_a_mistake_is_one_line_before_anything_flies(gatetune, toy, options, says):
    (toy / "settings.yaml").write_text("mission: toy.yaml\n")
    code, _, err = gatetune("campaign", "run", *options)
    assert code == 2 and says in err and err.count("\n") == 1
    assert not (toy / "runs").exists()


def test_a_metric_that_a_mission_has_not_stops_the_campaign(gatetune, toy):
    (toy / "toy.yaml").write_text(yaml.safe_dump({**FILE, "metric": "los"}))
    code, _, err = gatetune(*RUN, "--budget", 6)
    assert code == 2 and "without metric 'los', which it is tuned for; it has loss" in err
    trials = Campaign.open(toy / "runs/toy", read_only=True).trials()
    assert [t.state for t in trials] == ["running"]


def test_a_campaign_without_one_success_does_not_exit_0(gatetune, toy):
    entry = {"kind": "float", "low": 3.95, "high": 4, "default": 4}
    parameters = {**FILE["parameters"], "gain": entry}
    (toy / "toy.yaml").write_text(yaml.safe_dump({**FILE, "parameters": parameters, "baselines": {}}))
    code, out, _ = gatetune(*RUN, "--budget", 2)
    assert code == 1 and "tipped_over" in out
    mission = next((toy / "runs/toy/missions").iterdir())
    assert json.loads((mission / "mission.json").read_text())["reason"] == "tipped_over"
