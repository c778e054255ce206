"""Campaigns over rocks and conditions."""

from __future__ import annotations

import collections
from pathlib import Path

import fake_campaigns
import pytest
import synthetic
import yaml

from nbv.config import load_conditions
from nbv.errors import UserError
from tuner.campaign.begin import begin_campaign
from tuner.campaign.session import fly_campaign
from tuner.campaign.settings import CampaignSettings
from tuner.campaign.settings_file import settings_from_dict
from tuner.missions.executors import InProcessExecutor
from tuner.problem.worlds import World, worlds_over

TWO = load_conditions(["ideal", "field"])


def settings(**changes: object) -> CampaignSettings:
    return fake_campaigns.settings(**{"conditions": TWO, **changes})


def test_worlds_take_turns_in_rock_and_condition() -> None:
    worlds = worlds_over(["a", "b", "c"], ["ideal", "field"])
    assert [w.label for w in worlds] == ["a", "b, field", "c", "a, field", "b", "c, field"]
    assert worlds_over(["a", "b"], ["ideal"]) == (World("a"), World("b"))


def test_a_campaign_flies_every_rock_under_every_condition(tmp_path: Path) -> None:
    campaign = begin_campaign(tmp_path / "run", settings(replicates=2, budget=10, sampler="sobol"))
    fly_campaign(campaign, InProcessExecutor())
    trials = campaign.trials()
    flown = collections.Counter(t.world for t in trials[:8])
    assert flown == dict.fromkeys(worlds_over(["a", "b"], ["ideal", "field"]), 2)
    for trial in trials:
        config = campaign.settings.config(trial.values, trial.condition)
        assert (config.condition, config.digest()) == (trial.condition, trial.config_digest)
        assert ("_field_r" in trial.directory) == (trial.condition == "field")
    assert campaign.status().per_condition == {"ideal": 5, "field": 5}
    best = campaign.recommendation()
    assert best is not None and {row.world for row in best.per_rock} == set(flown)
    assert campaign.recommended_config().condition == "ideal"


def test_settings_keep_what_their_conditions_were(tmp_path: Path) -> None:
    """The file holds the worlds themselves: a condition that changes later changes no campaign that has begun."""
    own = tmp_path / "own.yaml"
    own.write_text("scene: {ambient: 0.1}\ntelemetry: rtk\n")
    asked = settings(conditions=load_conditions(["ideal", str(own)]))
    text = yaml.safe_dump(asked.to_dict())
    own.write_text("scene: {ambient: 0.3}\n")
    again = settings_from_dict(yaml.safe_load(text), "campaign.yaml")
    assert again.to_dict() == asked.to_dict()
    assert again.config(synthetic.DEFAULT, "own").scene.ambient == 0.1


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"rocks": ()}, "no rocks"),
        ({"rocks": ("a", "a")}, "named twice"),
        ({"conditions": ()}, "there is no condition to fly in"),
        ({"conditions": (*TWO, TWO[1])}, "condition 'field' is named twice"),
        (
            {"overrides": {"telemetry.drift_m": 0.1}},
            "telemetry.drift_m is set by condition 'field' and by overrides",
        ),
        ({"overrides": {"telemetry": "rtk"}}, "telemetry is set by condition 'field' and by overrides"),
    ],
)
def test_settings_that_make_no_campaign_are_told(changes: dict, said: str) -> None:
    with pytest.raises(UserError) as caught:
        settings(**changes)
    assert said in str(caught.value) and "\n" not in str(caught.value)
