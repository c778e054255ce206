"""A campaign over a fidelity of one's own: one function, a configuration in, metrics out."""

import dataclasses
import json
import shlex

import fake_campaigns
import pytest
import synthetic
from in_process import InProcessExecutor

from nbv import plugins
from nbv.errors import MissionFailure
from tuner.campaign.begin import begin_campaign
from tuner.campaign.campaign import Campaign
from tuner.campaign.session import run_campaign
from tuner.campaign.settings_file import read_settings_file
from tuner.problem.goal import Objective
from tuner.problem.space_files import space_from_dict

FRACTION, _ = synthetic.SPACE.parameters
ONE = dataclasses.replace(synthetic.SPACE, name="one", parameters=(FRACTION,))
QUALITY, SHOTS = Objective("quality"), Objective("costs.shots", "minimise")


def toy(config, rock, replicate, directory, **_):
    x = config.gate.budget_fraction
    if rock == "boulder":
        raise MissionFailure("tipped_over", "as on every boulder")
    if rock == "wrong":
        return [1.0]
    costs = {"shots": 100 + 10 * len(rock) + 60 * abs(x - 0.6)}
    return {"quality": 1 - x, "observable": {"f_score_48mm": 90 + x}, "costs": costs}


@pytest.fixture(autouse=True)
def in_process(monkeypatch):
    """The fidelity is these tests' own: workers of others would import it, too."""
    monkeypatch.setattr(plugins, "_registered", dict(plugins._registered))
    plugins.register("fidelities", "toy", toy)
    monkeypatch.setattr("tuner.commands.campaign.executor_at", lambda *_: InProcessExecutor())
    monkeypatch.setattr("tuner.commands.evaluate.local_pool", lambda *_: InProcessExecutor())


def run(directory, **changes):
    return fake_campaigns.run(directory, **{"fidelity": "toy", "space": ONE, **changes})


def test_metrics_alone_are_a_mission_and_anything_else_is_a_failure(tmp_path):
    campaign = run(tmp_path / "run", rocks=("slab", "wrong"), sampler="sobol", budget=4)
    by_rock = {rock: [t for t in campaign.trials() if t.rock == rock] for rock in ("slab", "wrong")}
    for trial in by_rock["slab"]:
        assert trial.raw == 90 + trial.values["gate.budget_fraction"] and trial.record.wall_s < 1.0
        assert (
            trial.value("costs.shots")
            == toy(campaign.settings.problem.config(trial.values), "slab", 0, None)["costs"]["shots"]
        )
    assert {t.reason for t in by_rock["wrong"]} == {"plugin_failed"}
    assert "not a MissionResult or metrics" in by_rock["wrong"][0].record.message


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rocks", "first", "second", "limit"),
    [(("one",), QUALITY, SHOTS, 20.0), (("one", "fourth"), SHOTS, QUALITY, 3.0)],
)
def test_a_limit_that_nothing_meets(gatetune, tmp_path, rocks, first, second, limit):
    """The search goes for the least violation, the least seen is recommended, said not to do, and its export needs an option."""
    asked = {
        "objective": first,
        "second": second,
        "limit": limit,
        "replicates": 2,
        "budget": 12,
        "initial": 4,
    }
    campaign = run(tmp_path / "my run", rocks=rocks, **asked)
    found, trials = campaign.recommendation(), [t for t in campaign.trials() if t.state == "complete"]
    wanted, path = 0.6 if second is SHOTS else 0.0, FRACTION.path
    assert abs(found.values[path] - wanted) < 0.05, found
    if len(rocks) == 1:
        violation = {t.values[path]: abs(t.values[path] - wanted) for t in trials}
        assert found.values[path] == min(violation, key=violation.get)
    missed_by = abs(found.limit.mean - found.limit.limit)
    assert not found.limit.satisfied and found.limit.missed_by == pytest.approx(missed_by)
    directory = campaign.directory
    said = gatetune.refused("export", directory, "--to", "gatetune.yaml")
    assert "--anyway" in said and f"{found.limit.missed_by:.3g}" in said
    assert not (directory / "gatetune.yaml").exists()
    first_file = gatetune.ok("export", directory).partition("write the first: gatetune ")[2]
    gatetune.ok(*shlex.split(first_file.partition("\n")[0]))  # what it says to type works
    tree = json.loads(gatetune.ok("confirm", directory, "--fidelity", "toy", "--replicates", 1, "--json"))
    (kept,) = tree["recommended"].values()
    assert kept["limit"]["satisfied"] is False
    assert "No configuration that was run is likely to meet" in gatetune.ok("campaign", "status", directory)


def test_a_space_that_has_been_tried_out_ends_the_campaign(tmp_path):
    track = {"kind": "int", "low": 6, "high": 7}
    two = space_from_dict({"name": "two", "parameters": {"b_aware.target_track_length": track}}, "test")
    asked = fake_campaigns.settings(fidelity="toy", space=two, rocks=("slab",), sampler="sobol", budget=12)
    campaign = begin_campaign(tmp_path / "run", asked)
    for _ in range(2):  # and a resume has nothing to do
        summary = run_campaign(campaign, InProcessExecutor())
        trials = campaign.trials()
        assert summary.stopped == "exhausted" and "all 2 configurations have run" in campaign.exhausted(
            trials
        )
        assert len({tuple(t.values.values()) for t in trials}) == 2 and len(trials) < 12


def test_a_campaign_without_one_success_does_not_exit_0(gatetune, tmp_path):
    asked = ("--fidelity", "toy", "--rock", "boulder", "--space", "gate", "--sampler", "sobol", "--budget", 2)
    code, out, _ = gatetune("campaign", "run", *asked, "--out", tmp_path / "run")
    assert code == 1 and "tipped_over" in out
    assert {t.reason for t in Campaign.open(tmp_path / "run", read_only=True).trials()} == {"tipped_over"}


def test_a_metric_that_missions_lack_is_refused_before_anything_flies(gatetune, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = gatetune.refused("campaign", "run", "--rock", "slab", "--objective", "observable.f_score_49mm")
    assert "did you mean observable.f_score_" in said and not (tmp_path / "runs").exists()


def test_paths_in_a_settings_file_are_taken_from_its_folder(tmp_path):
    (tmp_path / "deep").mkdir()
    text = "rocks: [slab, scans/a.obj]\nspace: mine.yaml\nlearn_from: [runs/a]\n"
    (tmp_path / "deep/settings.yaml").write_text(text)
    assert read_settings_file(tmp_path / "deep/settings.yaml") == {
        "rocks": ["slab", str(tmp_path / "deep/scans/a.obj")],
        "space": str(tmp_path / "deep/mine.yaml"),
        "learn_from": [str(tmp_path / "deep/runs/a")],
    }
