"""Campaigns over rocks and conditions; at a number of photographs; and that learn from earlier ones."""

import collections
import dataclasses
import functools
import shutil
from pathlib import Path
from typing import Any

import fake_campaigns
import optuna
import pytest
import synthetic
import yaml
from in_process import InProcessExecutor
from refusals import refused

from nbv.config import load_conditions
from nbv.errors import UserError
from tuner.campaign.begin import begin_campaign, learn_from
from tuner.campaign.campaign import Campaign
from tuner.campaign.session import run_campaign
from tuner.campaign.settings import CampaignSettings
from tuner.campaign.settings_file import settings_from_dict
from tuner.cli import app
from tuner.comparison.of_campaign import require_comparable
from tuner.problem.goal import Objective
from tuner.problem.instances import Instance, instances_over
from tuner.problem.observations import Observation
from tuner.problem.search_space import SearchSpace
from tuner.problem.space_files import load_search_space, space_from_dict
from tuner.report.campaign_page import write_campaign_report
from tuner.samplers.base import EarlierMissions

TWO = load_conditions(["ideal", "field"])


def settings(**changes: object) -> CampaignSettings:
    return fake_campaigns.settings(**{"conditions": TWO, **changes})


def test_worlds_take_turns_in_rock_and_condition() -> None:
    instances = instances_over(["a", "b", "c"], ["ideal", "field"])
    assert [w.label for w in instances] == ["a", "b, field", "c", "a, field", "b", "c, field"]
    assert instances_over(["a", "b"], ["ideal"]) == (Instance("a"), Instance("b"))


def test_a_campaign_flies_every_rock_under_every_condition(tmp_path: Path) -> None:
    campaign = begin_campaign(tmp_path / "run", settings(replicates=2, budget=10, sampler="sobol"))
    run_campaign(campaign, InProcessExecutor())
    trials = campaign.trials()
    evaluated = collections.Counter(t.instance for t in trials[:8])
    assert evaluated == dict.fromkeys(instances_over(["a", "b"], ["ideal", "field"]), 2)
    for trial in trials:
        config = campaign.settings.problem.config(trial.values, trial.condition)
        assert (config.condition, config.digest()) == (trial.condition, trial.record.config_digest)
        assert ("_field_r" in trial.record.directory.name) == (trial.condition == "field")
    assert campaign.status().per_condition == {"ideal": 5, "field": 5}
    assert campaign.recommendation() is not None
    assert campaign.recommended_config().condition == "ideal"


def test_settings_keep_what_their_conditions_were(tmp_path: Path) -> None:
    """The file holds the instances themselves: a condition that changes later changes no campaign that has begun."""
    own = tmp_path / "own.yaml"
    own.write_text("scene: {ambient: 0.1}\ntelemetry: rtk\n")
    asked = settings(conditions=load_conditions(["ideal", str(own)]))
    text = yaml.safe_dump(asked.to_dict())
    own.write_text("scene: {ambient: 0.3}\n")
    again = settings_from_dict(yaml.safe_load(text), "campaign.yaml")
    assert again.to_dict() == asked.to_dict()
    assert again.problem.config(synthetic.DEFAULT, "own").scene.ambient == 0.1


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"rocks": ()}, "no rocks"),
        ({"rocks": ("a", "a")}, "named twice"),
        ({"overrides": {"telemetry.drift_m": 0.1}}, "drift_m is set by condition 'field' and by overrides"),
        ({"overrides": {"telemetry": "rtk"}}, "telemetry is set by condition 'field' and by overrides"),
    ],
)
def test_settings_that_make_no_campaign_are_told(changes: dict, said: str) -> None:
    refused(said, settings, **changes)


PHOTOGRAPHS, QUALITY = Objective("costs.images", "minimise"), Objective()
SPACE = space_from_dict(
    {
        "name": "photographs",
        "base": load_search_space("photographs").base,
        "parameters": {
            "photographs": {"kind": "int", "low": 10, "high": 40, "default": 32},
            "seeds": {"kind": "int", "low": 8, "high": 24, "default": 24},
            "gate.budget_fraction": {"low": 0.0, "high": 1.0},
        },
    },
    "test",
)
LEAST = 0.3
run_few = functools.partial(fake_campaigns.run, space=SPACE, replicates=2)


def count(values: Any) -> float:
    return float(values["photographs"])


@pytest.fixture(scope="module")
def fewest(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """photographs@f_score>=0.3"""
    where = tmp_path_factory.mktemp("c") / "run"
    return run_few(where, objective=PHOTOGRAPHS, second=QUALITY, limit=LEAST, budget=11, seed=1)


def test_the_fewest_photographs_keep_the_limit_and_beat_the_default(fewest: Campaign) -> None:
    best = fewest.recommendation()
    assert best is not None and best.limit is not None and best.limit.satisfied
    assert best.mean == count(best.values)
    assert best.default_mean == 32.0
    assert best.improvement == 32.0 - best.mean > 0
    assert best.values in [t.values for t in fewest.trials()]  # run


def test_optunas_best_trial_keeps_the_limit(fewest: Campaign) -> None:
    """Without constraints the best is the mission with the fewest photographs, the worst of all models."""
    storage = optuna.storages.JournalStorage(
        optuna.storages.journal.JournalFileBackend(str(fewest.directory / "study.journal"))
    )
    study = optuna.load_study(study_name=fewest.settings.name, storage=storage)
    kept = [t for t in fewest.trials() if t.second is not None and t.second >= LEAST]
    assert 0 < len(kept) < len(fewest.trials())
    assert study.best_value == min(t.raw for t in kept if t.raw is not None)
    assert all(
        list(trial.constraints.values()) == [pytest.approx(LEAST - mission.second)]
        for trial, mission in zip(study.trials, fewest.trials(), strict=True)
        if mission.second is not None
    )


FRACTION, D95 = synthetic.SPACE.parameters
ONE_PARAMETER = dataclasses.replace(synthetic.SPACE, name="one", parameters=(FRACTION,))
run_long = functools.partial(fake_campaigns.run, budget=24)


@pytest.fixture(scope="module")
def earlier(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    return run_long(tmp_path_factory.mktemp("earlier") / "run")


def learned(campaign: Campaign, space: SearchSpace) -> list[Observation]:
    s = fake_campaigns.settings(space=space, rocks=("c",))
    return list(learn_from([str(campaign.directory)], s.problem, s.objective).observations)


@pytest.mark.slow
def test_the_best_of_an_earlier_campaign_fly_first_on_new_rocks(earlier: Campaign, tmp_path: Path) -> None:
    known = shutil.copytree(earlier.directory, tmp_path / "known")
    campaign = run_long(tmp_path / "run", rocks=("c", "d"), budget=8, learn_from=(str(known),))
    trials = campaign.trials()
    assert [t.record.metadata["phase"] for t in trials[:3]] == ["default", "default", "earlier missions"]
    assert campaign.learned is not None and trials[2].values == campaign.learned.best(1)[0]
    # Near the optimum, where the default is not.
    assert synthetic.true_value(trials[2].values) > 0.9 > synthetic.true_value(trials[0].values)
    shutil.rmtree(known)  # the campaign has its own copy
    again = Campaign.open(campaign.directory)
    assert again.learned is not None and again.learned.best(3) == campaign.learned.best(3)
    page = write_campaign_report(again).read_text()
    assert "missions of earlier campaigns" in page and "learn_from:" in page
    (campaign.directory / "learned_from.json").unlink()
    refused(r"learned_from.json cannot be read .* restore it", Campaign.open, campaign.directory)


@pytest.mark.slow
def test_missions_are_moved_between_search_spaces(earlier: Campaign, tmp_path: Path) -> None:
    evaluated, known = earlier.history(), learned(earlier, synthetic.SPACE)
    assert [(o.values, o.outcome) for o in known] == [(o.values, o.outcome) for o in evaluated]
    # From one parameter to two: the second has the value at which it was held. What neither tunes may differ.
    fixed = {"dense.agreeing_views": 3}
    small = run_long(tmp_path / "small", space=ONE_PARAMETER, sampler="sobol", overrides=fixed)
    moved = learned(small, synthetic.SPACE)
    assert len(moved) == len(small.history())
    assert {o.values["gate.d95_m"] for o in moved} == {small.settings.problem.base.gate.d95_m}
    # From two to one: only the missions that have the other at its default, here the first two.
    refused(
        "2 of its 2[4-6] missions are configurations of search space 'one'", learned, earlier, ONE_PARAMETER
    )
    low = dataclasses.replace(FRACTION, high=0.4)
    narrow = dataclasses.replace(synthetic.SPACE, name="narrow", parameters=(low, D95))
    inside = sum(o.values["gate.budget_fraction"] <= 0.4 for o in evaluated)
    assert 0 < inside < 20
    refused(rf"{inside} of its 2[4-6] missions", learned, earlier, narrow)


@pytest.mark.slow
def test_what_cannot_be_learned_from_is_named(earlier: Campaign, tmp_path: Path) -> None:
    refused("nowhere", run_long, tmp_path / "run", learn_from=(str(tmp_path / "nowhere"),))
    same = earlier.directory / ".." / earlier.directory.name
    with pytest.raises(UserError, match="is named twice to learn from"):
        run_long(tmp_path / "run", learn_from=(str(earlier.directory), str(same)))
    assert not (tmp_path / "run").exists()
    with pytest.raises(UserError, match="learning from earlier campaigns needs sampler gp, not sobol"):
        fake_campaigns.settings(sampler="sobol", learn_from=(str(earlier.directory),))


@pytest.mark.slow
def test_evaluation_refuses_rocks_that_were_learned_from(tmp_path: Path) -> None:
    first = run_long(tmp_path / "first", rocks=("cleft-3",), sampler="sobol")
    second = run_long(tmp_path / "second", rocks=("boulder",), initial=24, learn_from=(str(first.directory),))
    sources = (str(second.directory),)
    third = run_long(tmp_path / "third", rocks=("slab",), budget=6, learn_from=sources)
    for rock in ("boulder", "cleft-3"):
        with pytest.raises(UserError, match=rf"rock '{rock}' was tuned on in .* learned from"):
            app(["evaluate", str(third.directory), "--rock", rock], standalone_mode=False)
        with pytest.raises(UserError, match=f"{rock} is compared on, and what the campaign learns from"):
            require_comparable(fake_campaigns.settings(compare_on=(rock,), learn_from=sources))
    of_earlier_version = EarlierMissions.from_json('{"rocks": ["boulder"], "missions": []}', synthetic.SPACE)
    assert not of_earlier_version.seen
