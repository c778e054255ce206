"""Campaigns over families, where every mission meets a fresh rock, and over rocks and conditions."""

import collections
import json
from pathlib import Path

import fake_campaigns
import pytest
import synthetic
import yaml
from in_process import InProcessExecutor

from nbv.config import load_conditions
from nbv.errors import UserError
from nbv.rocks.families import SHAPES
from tuner.campaign.begin import begin_campaign
from tuner.campaign.campaign import Campaign
from tuner.campaign.session import run_campaign
from tuner.campaign.settings import CampaignSettings
from tuner.campaign.settings_file import resolved_settings, settings_from_dict
from tuner.comparison.of_campaign import held_out
from tuner.problem.instances import Instance, instances_over

BUDGET = 12


def settings_of(*rocks: str, **more: object):
    tree = {"name": "drawn", "space": "photographs", "fidelity": "geometric", "sampler": "sobol"}
    return resolved_settings({**tree, "rocks": list(rocks), "budget": BUDGET, **more}, "test")


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    directory = tmp_path_factory.mktemp("drawn") / "run"
    campaign = begin_campaign(directory, settings_of("any-slab", "any-boulder"))
    run_campaign(campaign, InProcessExecutor())
    return campaign


@pytest.mark.slow
def test_every_fresh_rock_is_flown_by_a_proposal_and_by_the_default(evaluated: Campaign) -> None:
    default, trials = evaluated.settings.problem.default, evaluated.trials()
    assert len(trials) == BUDGET
    by_rock = collections.defaultdict(list)
    for t in trials:
        by_rock[t.rock, t.replicate].append(dict(t.values) == default)
    before_verification = [t for t in trials if t.number < BUDGET * 2 // 3]
    for t in before_verification[:-1]:
        assert any(by_rock[t.rock, t.replicate])
    proposals = [t for t in trials if dict(t.values) != default]
    assert len({(t.rock, t.replicate) for t in proposals}) == len(proposals)


@pytest.mark.slow
def test_the_rock_met_is_a_training_rock_that_the_seed_decides(evaluated: Campaign) -> None:
    met = collections.defaultdict(set)
    for t in evaluated.trials():
        rock = json.loads((t.record.directory / "mission.json").read_text())["rock"]
        family, seed = rock.split("-")
        assert t.rock == f"any-{family}" and int(seed) < 10_000
        met[t.rock, t.replicate].add(rock)
    assert all(len(rocks) == 1 for rocks in met.values())
    assert len(set.union(*met.values())) == len(met)
    other = settings_of("any-slab", seed=1).problem
    assert other.drawn_rock("any-slab", 0) != evaluated.settings.problem.drawn_rock("any-slab", 0)


@pytest.mark.slow
def test_families_are_evaluated_on_their_own_held_out_rocks(evaluated: Campaign) -> None:
    plan = held_out(evaluated, replicates=2, fidelity="geometric").plan
    families = sorted({place.removeprefix("any-") for place in evaluated.settings.rocks})
    assert sorted(plan.rocks) == sorted(f"{f}-{seed}" for f in families for seed in (20_000, 20_001))
    assert plan.replicates == 1


def test_shapes_are_drawn_as_rocks_are() -> None:
    assert settings_of("any-shapes").rocks == tuple(f"any-{family}" for family in SHAPES)
    for rocks in (("any", "any-slab"), ("any-shapes", "any-machine")):
        with pytest.raises(UserError, match=f"'{rocks[1]}' is named twice"):
            settings_of(*rocks)


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
        ({"rocks": ("any-pebble",)}, "no family 'pebble' of rocks; choose from boulder, slab"),
        ({"rocks": ("any-slab", "fin")}, "any-slab is a family of rocks and 'fin' is a rock"),
        ({"overrides": {"telemetry.drift_m": 0.1}}, "drift_m is set by condition 'field' and by overrides"),
        ({"overrides": {"telemetry": "rtk"}}, "telemetry is set by condition 'field' and by overrides"),
    ],
)
def test_settings_that_make_no_campaign_are_told(changes: dict, said: str) -> None:
    with pytest.raises(UserError) as caught:
        settings(**changes)
    assert said in str(caught.value) and "\n" not in str(caught.value)
