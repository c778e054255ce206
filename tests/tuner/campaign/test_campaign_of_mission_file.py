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
from tuner.jobs import evaluate
from tuner.missions.external.mission_file import load_mission_file

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


SHOTS = """
def fly(request):
    x, far = request["configuration"]["x"], len(request["instance"]["name"])
    return {"metrics": {"quality": 1 - x}, "costs": {"shots": 100 + 10 * far + 60 * abs(x - 0.6)}}
"""


@pytest.mark.parametrize(
    ("instances", "objective", "budget"),
    [
        (["one"], "quality@costs.shots<=20", 12),
        (["one", "fourth"], "quality@costs.shots<=20", 12),
        (["one"], "costs.shots@quality>=3", 12),
    ],
)
def test_a_limit_that_nothing_meets(gatetune, tmp_path, instances, objective, budget):
    """The search goes for the least violation, the least seen is recommended, and its export needs an option."""
    (tmp_path / "shots.py").write_text(SHOTS)
    x = {"kind": "float", "low": 0, "high": 1, "default": 0.9}
    file = {"name": "shots", "function": "shots:fly", "parameters": {"x": x}, "instances": instances}
    file |= {"metric": "quality", "direction": "maximise", "replicates": 2}
    (tmp_path / "shots.yaml").write_text(yaml.safe_dump(file))
    asked = {"mission": str(tmp_path / "shots.yaml"), "budget": budget, "initial": 4, "objective": objective}
    campaign = begin_campaign(tmp_path / "runs/shots", settings_from_dict({"name": "shots", **asked}, "test"))
    run_campaign(campaign, InProcessExecutor())
    found, trials = campaign.recommendation(), [t for t in campaign.trials() if t.state == "complete"]
    wanted = 0.6 if "shots<=" in objective else 0.0
    assert abs(found.values["x"] - wanted) < 0.05, found
    violation = {t.values["x"]: abs(t.values["x"] - wanted) for t in trials}
    if len(instances) == 1:
        assert found.values["x"] == min(violation, key=violation.get)
    assert not found.limit.kept and found.limit.missed_by == pytest.approx(
        abs(found.limit.mean - found.limit.limit)
    )
    run = campaign.directory
    code, _, err = gatetune("export", run, "--to", "gatetune.yaml")
    assert code == 2 and err.count("\n") == 1 and "--anyway" in err and f"{found.limit.missed_by:.3g}" in err
    assert not (run / "gatetune.yaml").exists()
    code, _, err = gatetune("export", run, "--to", "gatetune.yaml", "--anyway")
    assert code == 0 and (run / "gatetune.yaml").is_file(), err


@pytest.mark.parametrize(
    ("parameter", "says"),
    [
        ([1, 1.0, 2], "1 and 1.0 are one value"),
        ([True, 1], "True and 1 are one value"),
        ([100, 1e2], "100 and 100.0 are one value"),
        ([0.1, 0.1], "0.1 is given twice"),
        (["a", "b", "a"], "'a' is given twice"),
        ([0, False], "0 and False are one value"),
        ([0.0, -0.0], "one value"),
        (["1", 1], "'1' and 1 are one value"),
    ],
)
def test_choices_that_are_one_value_are_refused(gatetune, toy, parameter, says):
    mode = {"kind": "categorical", "choices": parameter, "default": parameter[0]}
    changed = FILE | {"parameters": {**FILE["parameters"], "mode": mode}}
    (toy / "toy.yaml").write_text(yaml.safe_dump(changed))
    code, _, err = gatetune(*RUN, "--budget", 1)
    assert code == 2 and "mode" in err and says in err and err.count("\n") == 1


def test_a_choice_is_stored_as_it_was_declared(toy):
    mode = {"kind": "categorical", "choices": [1, 2], "default": 1.0}
    (toy / "toy.yaml").write_text(yaml.safe_dump(FILE | {"parameters": {"mode": mode}, "baselines": {}}))
    mission = load_mission_file(toy / "toy.yaml")
    assert {repr(mission.complete(v)["mode"]) for v in ({}, {"mode": 1}, {"mode": True})} == {"1"}


def test_a_metric_with_a_limit_in_the_mission_file_is_refused(gatetune, toy):
    (toy / "toy.yaml").write_text(yaml.safe_dump(FILE | {"metric": "loss@costs.fuel_kg<=2"}))
    code, _, err = gatetune(*RUN, "--budget", 1)
    assert code == 2 and "metric: loss" in err and "--objective 'loss@costs.fuel_kg<=2'" in err
    (toy / "toy.yaml").write_text(yaml.safe_dump(FILE))  # and the advice works
    asked = ["--sampler", "gp", "--objective", "loss@costs.fuel_kg<=2"]
    code, _, err = gatetune(*RUN, "--budget", 1, *asked)
    assert code == 0, err


@pytest.mark.parametrize("where", [".", "../toy", "./"])
def test_commands_inside_a_run_directory(gatetune, toy, monkeypatch, where):
    begun(toy, 4)
    monkeypatch.chdir(toy / "runs/toy")
    file = toy / "toy.yaml"
    for words in (
        ["campaign", "resume", where, "--mission", file],
        ["evaluate", where, "--mission", file, "--workers", 1],
        ["evaluate", where, "--mission", file, "--workers", 1, "--replicates", 1],
        ["mission", "view", where],
        ["campaign", "status", where],
        ["export", where],
    ):
        code, _, err = gatetune(*words)
        assert code == 0, (words, err)


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
