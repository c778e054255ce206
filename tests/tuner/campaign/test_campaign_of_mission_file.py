"""A campaign over a mission file, from the command line: everything that a campaign over our own missions has."""

import contextlib
import json

import pytest
import yaml
from in_process import InProcessExecutor

from nbv.checksums import with_checksum
from nbv.errors import UserError
from tuner.campaign.begin import begin_campaign
from tuner.campaign.campaign import Campaign
from tuner.campaign.session import run_campaign
from tuner.campaign.settings_file import read_settings_file, settings_from_dict
from tuner.jobs import evaluate, tune

FLY = """
import math
def run(request):
    c, away = request["configuration"], len(request["instance"]["name"])
    if c["gain"] > 3.9:
        return {"failure": "tipped_over"}
    return {"metrics": {"loss": (c["gain"] - away) ** 2 + (c["mode"] == "bad")}, "costs": {"fuel_kg": c["gain"]}}
"""
FILE = {
    "name": "toy",
    "function": "toy_mission:run",
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


def begun(toy, missions=0):
    """A campaign of four missions in ``runs/toy``, of which some have run."""
    asked = settings_from_dict(
        {"name": "toy", "mission": str(toy / "toy.yaml"), "budget": 4, "sampler": "sobol"}, "test"
    )
    campaign = begin_campaign(toy / "runs/toy", asked)

    def stop(event):
        if event.kind == "finished" and event.finished == missions:
            raise KeyboardInterrupt

    if missions:
        with contextlib.suppress(KeyboardInterrupt):
            run_campaign(campaign, InProcessExecutor(), stop)
    return campaign


def test_an_own_cost_is_an_objective_and_a_parameter_is_computed(gatetune, toy):
    """``gain`` is a parameter that the mission leaves out of its costs."""
    asked = {"mission": str(toy / "toy.yaml"), "budget": 5, "initial": 4, "objective": "loss@costs.gain<=2"}
    campaign = begin_campaign(toy / "runs/two", settings_from_dict({"name": "two", **asked}, "test"))
    assert run_campaign(campaign, InProcessExecutor()).status.finished == 5
    trials = [t for t in campaign.trials() if t.state == "complete"]
    assert trials and all(t.second == -t.values["gain"] for t in trials)
    found = campaign.recommendation()
    assert found is not None and found.values["gain"] <= 2
    code, _, err = gatetune(
        "evaluate", "runs/two", "--mission", "toy.yaml", "--replicates", 1, "--workers", 1
    )
    assert code == 0, err


def test_paths_in_a_settings_file_are_taken_from_its_folder(toy):
    (toy / "deep").mkdir()
    text = "mission: ../toy.yaml\nrocks: [slab, scans/a.obj]\nspace: mine.yaml\nlearn_from: [shipped]\n"
    (toy / "deep/settings.yaml").write_text(text)
    found = read_settings_file(toy / "deep/settings.yaml")
    assert found == {
        "mission": str(toy / "deep/../toy.yaml"),
        "rocks": ["slab", str(toy / "deep/scans/a.obj")],
        "space": str(toy / "deep/mine.yaml"),
        "learn_from": ["shipped"],
    }


COMMANDS = [
    ["evaluate", "runs/toy", "--workers", 1],
    ["confirm", "runs/toy", "--workers", 1],
    ["campaign", "resume", "runs/toy", "--workers", 1],
    ["campaign", "resume", "runs/toy", "--missions", 9, "--workers", 1],
]


@pytest.mark.parametrize("path", ["toy.yaml", None])
@pytest.mark.parametrize("command", COMMANDS)
def test_a_run_directory_alone_runs_nothing(gatetune, toy, command, path):
    """It may be somebody else's; its mission file may be named relative to where the command runs."""
    begun(toy, 2)
    (toy / "toy_mission.py").write_text("open('ran', 'w')\n" + FLY)
    if path is not None:
        file = toy / "runs/toy/campaign.yaml"
        tree = yaml.safe_load(file.read_text())
        tree["settings"]["mission"]["file"] = path
        file.write_text(yaml.safe_dump(with_checksum(tree)))
    code, _, err = gatetune(*command)
    assert code == 2 and f"if you trust it, name it: --mission {toy}/toy.yaml" in err and err.count("\n") == 1
    assert not (toy / "ran").exists()


def test_a_function_runs_only_where_the_caller_of_tune_names_it(toy, monkeypatch):
    """Also where other settings are given: they are the campaign's own, and say nothing of the code."""
    monkeypatch.syspath_prepend(toy)
    (toy / "evil_runner.py").write_text("open('ran', 'w')\ndef fly(*a, **k): ...\n")
    settings = {
        "name": "x",
        "budget": 2,
        "rocks": ["slab"],
        "space": "gate",
        "fidelity": "evil_runner:run",
    }
    begin_campaign(toy / "runs/x", settings_from_dict(settings, "test"))
    monkeypatch.chdir(toy)
    for given in ({}, {"budget": 2}):
        with pytest.raises(UserError, match="if you trust it, name it: --fidelity evil_runner:run"):
            tune(toy / "runs/x", **given)
    assert not (toy / "ran").exists()


def test_what_is_named_is_run(gatetune, toy):
    """By its mission file, which has to be the campaign's own."""
    begun(toy, 4)
    for command in (["campaign", "resume"], ["evaluate"], ["confirm"]):
        code, _, err = gatetune(*command, "runs/toy", "--mission", "toy.yaml", "--workers", 1)
        assert code == 0, err
    (toy / "other.yaml").write_text(yaml.safe_dump({**FILE, "time_limit_s": 3}))
    code, _, err = gatetune("campaign", "resume", "runs/toy", "--mission", "other.yaml")
    assert code == 2 and "is not the mission file that the campaign in runs/toy began with" in err
    with pytest.raises(UserError, match="if you trust it, name it"):
        evaluate(Campaign.open(toy / "runs/toy", read_only=True))


def test_a_changed_program_is_asked_about(gatetune, toy):
    begun(toy, 2)
    (toy / "toy_mission.py").write_text(FLY + "\n")
    resume = ("campaign", "resume", "runs/toy", "--mission", "toy.yaml", "--workers", 1)
    code, _, err = gatetune(*resume)
    assert (
        code == 2 and "the program of its missions changed after trial" in err and "--accept-changes" in err
    )
    assert gatetune(*resume, "--accept-changes")[0] == 0
    assert len(Campaign.open(toy / "runs/toy", read_only=True).trials()) == 4


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--mission", "nowhere.yaml"], "gatetune mission init"),
        (["--mission", "toy.yaml", "--space", "gate"], "--space applies to missions over rocks"),
        (["--mission", "toy.yaml", "--condition", "field"], "--condition applies to missions over rocks"),
        (["--mission", "toy.yaml", "--set", "gate.kind=covis"], "--set applies to missions over rocks"),
        (["--mission", "toy.yaml", "--rock", "ccc"], "'ccc' is held out"),
        (["--mission", "toy.yaml", "--rock", "slab"], "'slab' is not an instance"),
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


def test_a_space_that_has_been_tried_out_ends_the_campaign(gatetune, toy):
    gain = {"kind": "int", "low": 0, "high": 1, "default": 0}
    changed = {
        "parameters": {**FILE["parameters"], "gain": gain},
        "instances": ["a"],
        "baselines": {},
        "replicates": 1,
    }
    (toy / "toy.yaml").write_text(yaml.safe_dump({**FILE, **changed}))
    again = ["campaign", "resume", "runs/toy", "--mission", "toy.yaml", "--workers", 1]
    for command in (RUN, again):
        code, out, err = gatetune(*command, *(["--budget", 12] if command is RUN else []))
        assert code == 0, err
        trials = Campaign.open(toy / "runs/toy", read_only=True).trials()
        assert (
            f"all 4 configurations have run with every replicate: the other {12 - len(trials)} missions"
            in out
        )
        assert len({tuple(t.values.values()) for t in trials}) == 4 and len(trials) < 12


def test_a_campaign_without_one_success_does_not_exit_0(gatetune, toy):
    entry = {"kind": "float", "low": 3.95, "high": 4, "default": 4}
    parameters = {**FILE["parameters"], "gain": entry}
    (toy / "toy.yaml").write_text(yaml.safe_dump({**FILE, "parameters": parameters, "baselines": {}}))
    code, out, _ = gatetune(*RUN, "--budget", 2)
    assert code == 1 and "tipped_over" in out
    mission = next((toy / "runs/toy/missions").iterdir())
    assert json.loads((mission / "mission.json").read_text())["reason"] == "tipped_over"
