"""A campaign over a mission file, from the command line: everything that a campaign over our own missions has."""

import errno
import json
import re
import shlex
from pathlib import Path

import pytest
import yaml
from fake_campaigns import stop_after
from in_process import InProcessExecutor

from nbv.checksums import with_checksum
from nbv.errors import UserError
from tuner.campaign.begin import begin_campaign
from tuner.campaign.campaign import Campaign
from tuner.campaign.session import run_campaign
from tuner.campaign.settings_file import read_settings_file, settings_from_dict
from tuner.commands.console import executor_at
from tuner.jobs import evaluate

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


@pytest.fixture(autouse=True)
def in_process(monkeypatch):
    """Each mission is a program of its own in any case."""
    monkeypatch.setattr("tuner.commands.campaign.executor_at", lambda *_: InProcessExecutor())
    monkeypatch.setattr("tuner.comparison.of_campaign.local_executor", lambda *_: InProcessExecutor())


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
    if missions:
        run_campaign(campaign, InProcessExecutor(), stop_after(missions))
    return campaign


def test_an_own_cost_is_an_objective_and_a_parameter_is_computed(gatetune, toy, monkeypatch):
    """``gain`` is a parameter that the mission leaves out of its costs."""
    asked = {"mission": str(toy / "toy.yaml"), "budget": 5, "initial": 4, "objective": "loss@costs.gain<=2"}
    campaign = begin_campaign(toy / "runs/two", settings_from_dict({"name": "two", **asked}, "test"))
    assert run_campaign(campaign, InProcessExecutor()).status.finished == 5
    trials = [t for t in campaign.trials() if t.state == "complete"]
    assert trials and all(t.second == -t.values["gain"] for t in trials)
    found = campaign.recommendation()
    assert found is not None and found.values["gain"] <= 2
    evaluate = ("evaluate", "runs/two", "--mission", "toy.yaml", "--replicates", 1, "--workers", 1)
    assert gatetune.ok(*evaluate, "--out", "elsewhere").count("does not count") == 2  # first and last
    assert "does not count" not in gatetune.ok(*evaluate)

    def refuse(_):
        raise UserError("cannot write it")

    def read_only(*_):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr("tuner.report.campaign_page.write_campaign_report", refuse)
    monkeypatch.setattr("tuner.commands.campaign_display.write_atomic", read_only)
    said = gatetune.ok(*evaluate)  # of a campaign that may only be read
    assert "stays as it was: cannot write it" in said and "What next" in said
    assert "comparison.json stays as it was: Read-only file system" in said


SHOTS = """
def fly(request):
    x, far = request["configuration"]["x"], len(request["instance"]["name"])
    return {"metrics": {"quality": 1 - x}, "costs": {"shots": 100 + 10 * far + 60 * abs(x - 0.6)}}
"""


@pytest.mark.parametrize(
    ("instances", "objective"),
    [(["one"], "quality@costs.shots<=20"), (["one", "fourth"], "costs.shots@quality>=3")],
)
def test_a_limit_that_nothing_meets(gatetune, tmp_path, instances, objective):
    """The search goes for the least violation, the least seen is recommended, said not to do, and its export needs an option."""
    (tmp_path / "shots.py").write_text(SHOTS)
    x = {"kind": "float", "low": 0, "high": 1, "default": 0.9}
    file = {"name": "shots", "function": "shots:fly", "parameters": {"x": x}, "instances": instances}
    file |= {"metric": "quality", "direction": "maximise", "replicates": 2}
    (tmp_path / "shots.yaml").write_text(yaml.safe_dump(file))
    asked = {"mission": str(tmp_path / "shots.yaml"), "budget": 12, "initial": 4, "objective": objective}
    campaign = begin_campaign(
        tmp_path / "runs/my shots", settings_from_dict({"name": "shots", **asked}, "test")
    )
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
    said = gatetune.refused("export", run, "--to", "gatetune.yaml")
    assert "--anyway" in said and f"{found.limit.missed_by:.3g}" in said
    assert not (run / "gatetune.yaml").exists()
    said = gatetune.ok("export", run)  # what it says to type works
    gatetune.ok(*shlex.split(said.partition("write the first: gatetune ")[2]))
    assert (run / "gatetune.yaml").is_file()
    asked = ("confirm", run, "--mission", "shots.yaml", "--replicates", 1, "--workers", 1, "--json")
    tree = json.loads(gatetune.ok(*asked))
    (kept,) = (verdict for verdict in tree["verdicts"] if "Constraint" in verdict["text"])
    assert kept["kind"] == "not kept" and "comes nearest to it" in tree["notes"][-1]


def test_commands_inside_a_run_directory_say_that_less_of_what_is_minimised_is_better(
    gatetune, toy, monkeypatch
):
    """And nothing of rocks, which other missions have."""
    (toy / "toy.yaml").write_text(yaml.safe_dump({**FILE, "instances": ["bb"], "replicates": 1}))
    begun(toy, 4)
    monkeypatch.chdir(toy / "runs/toy")
    named = ("--mission", toy / "toy.yaml", "--workers", 1)
    gatetune.ok("campaign", "resume", "../toy", *named)
    for command, where in (("evaluate", "."), ("confirm", "../toy")):
        asked = (command, where, *named, "--replicates", 1)
        out, tree = gatetune.ok(*asked), json.loads(gatetune.ok(*asked, "--json"))
        verdict = tree["verdicts"][0]["text"]
        gain = -tree["summary"]["rows"][0]["differences"]["tuned"]["mean"]
        assert gain > 0 and f"a gain of {gain:.1f}" in verdict and verdict in out
        page = Path(tree["report"]).read_text()
        assert verdict in page
        assert not re.findall(".*(?:rock|photograph|dense cloud).*", out + words_of(page))
    for command in ("mission view", "campaign status", "export"):
        gatetune.ok(*command.split(), ".")
    page = (toy / "runs/toy/report.html").read_text()
    assert 'id="next-command">gatetune ' in page and "rock" not in words_of(page)


def words_of(page):
    """Without scripts, styles, tags and downloads."""
    return re.sub(r"(?s)<script.*?</script>|<style.*?</style>|<pre.*?</pre>|<[^>]*>", "", page)


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
    assert f"if you trust it, name it: --mission {toy}/toy.yaml" in gatetune.refused(*command)
    assert not (toy / "ran").exists()


def test_the_mission_file_named_is_the_campaigns_own(gatetune, toy):
    begun(toy, 4)
    (toy / "other.yaml").write_text(yaml.safe_dump({**FILE, "time_limit_s": 3}))
    said = gatetune.refused("campaign", "resume", "runs/toy", "--mission", "other.yaml")
    assert "is not the mission file that the campaign in runs/toy began with" in said
    with pytest.raises(UserError, match="if you trust it, name it"):
        evaluate(Campaign.open(toy / "runs/toy", read_only=True))


def test_a_changed_program_is_asked_about(gatetune, toy):
    begun(toy, 2)
    (toy / "toy_mission.py").write_text(FLY + "\n")
    resume = ("campaign", "resume", "runs/toy", "--mission", "toy.yaml", "--missions", 6, "--workers", 1)
    said = gatetune.refused(*resume)
    assert "the program of its missions changed after trial" in said and "--accept-changes" in said
    gatetune.ok(*resume, "--accept-changes")
    assert len(Campaign.open(toy / "runs/toy", read_only=True).trials()) == 6


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
        (["--objective", "observable.f_score_49mm"], "did you mean observable.f_score_"),
    ],
)
def test_a_mistake_is_one_line_before_anything_flies(gatetune, toy, options, says):
    (toy / "settings.yaml").write_text("mission: toy.yaml\n")
    assert says in gatetune.refused("campaign", "run", *options)
    assert not (toy / "runs").exists()


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"metric": "los"}, "without metric 'los', which it is tuned for; it has loss"),
        ({"function": None, "command": ["no-such-program"]}, "cannot run 'no-such-program'"),
    ],
)
def test_what_no_mission_can_mend_stops_the_campaign(gatetune, toy, monkeypatch, changes, says):
    monkeypatch.setattr("tuner.commands.campaign.executor_at", executor_at)  # a worker's log is a file
    file = {key: value for key, value in {**FILE, **changes}.items() if value is not None}
    (toy / "toy.yaml").write_text(yaml.safe_dump(file))
    assert says in gatetune.refused(*RUN, "--budget", 6)
    trials = Campaign.open(toy / "runs/toy", read_only=True).trials()
    assert [t.state for t in trials] == ["running"]


def test_what_the_machine_ended_is_shown_and_run_again_once_it_is_mended(gatetune, toy):
    (toy / "toy_mission.py").write_text("raise SystemExit(3)\n" + FLY)
    code, out, _ = gatetune(*RUN, "--budget", 1)
    assert code == 1 and " lost: no result.json; it ended with status 3" in out
    (toy / "toy_mission.py").write_text(FLY)
    gatetune.ok("campaign", "resume", "runs/toy", "--mission", "toy.yaml", "--accept-changes", "--workers", 1)
    assert [t.state for t in Campaign.open(toy / "runs/toy", read_only=True).trials()] == ["complete"]


def test_a_space_that_has_been_tried_out_ends_the_campaign(gatetune, toy):
    gain = {"kind": "int", "low": 0, "high": 1, "default": 0}
    parameters = {**FILE["parameters"], "gain": gain}
    changed = {"parameters": parameters, "instances": ["a"], "baselines": {}, "replicates": 1}
    (toy / "toy.yaml").write_text(yaml.safe_dump({**FILE, **changed}))
    again = ["campaign", "resume", "runs/toy", "--mission", "toy.yaml", "--workers", 1]
    for command in (RUN, again):
        out = gatetune.ok(*command, *(["--budget", 12] if command is RUN else []))
        trials = Campaign.open(toy / "runs/toy", read_only=True).trials()
        assert f"all 4 configurations have run with every replicate: the other {12 - len(trials)}" in out
        assert len({tuple(t.values.values()) for t in trials}) == 4 and len(trials) < 12


def test_a_campaign_without_one_success_does_not_exit_0(gatetune, toy):
    entry = {"kind": "float", "low": 3.95, "high": 4, "default": 4}
    parameters = {**FILE["parameters"], "gain": entry}
    (toy / "toy.yaml").write_text(yaml.safe_dump({**FILE, "parameters": parameters, "baselines": {}}))
    code, out, _ = gatetune(*RUN, "--budget", 2)
    assert code == 1 and "tipped_over" in out
    mission = next((toy / "runs/toy/missions").iterdir())
    assert json.loads((mission / "mission.json").read_text())["reason"] == "tipped_over"
