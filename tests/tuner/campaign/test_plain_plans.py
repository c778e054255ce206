"""Plain orbits, random views and the default are arms of a campaign, and nothing that they beat is recommended."""

import dataclasses
import itertools
import json
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import fake_campaigns
import pytest
import yaml
from made_evaluations import made_metrics, made_trial

from nbv.config import config_from_dict, load_conditions, preset
from nbv.errors import UserError
from nbv.viewpoints import seed_viewpoints
from tuner.campaign.campaign import Campaign
from tuner.campaign.settings import CampaignSettings
from tuner.campaign.settings_file import settings_from_dict
from tuner.comparison.advice import Next, advice_of, next_step
from tuner.comparison.of_campaign import PlannedComparison
from tuner.comparison.plan import EvaluationPlan
from tuner.comparison.result import Results, held_out_results, training_results
from tuner.comparison.verdict import Kind
from tuner.export.photogrammetry_nbv import read_file
from tuner.problem.baselines import TUNED, baseline
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation
from tuner.problem.search_space import Values
from tuner.problem.space_files import load_search_space
from tuner.recommendation.choose import recommend
from tuner.report.answer import advice_lines, use_sentence

TWENTY = {"seed.count": 12, "stop.adaptive_budget": 8}


def settings(**changes: object) -> CampaignSettings:
    asked = {"space": load_search_space("plan_and_gate"), "overrides": TWENTY, "budget": 24, "replicates": 2}
    return fake_campaigns.settings(**{**asked, **changes})


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    asked = {"space": load_search_space("plan_and_gate"), "overrides": TWENTY, "replicates": 2}
    return fake_campaigns.run(tmp_path_factory.mktemp("c") / "run", budget=20, sampler="random", **asked)


def test_the_default_is_the_papers_plan_and_all_take_as_many_photographs() -> None:
    s = settings(overrides={})
    assert seed_viewpoints(s.problem.base) == seed_viewpoints(preset("campaign"))
    twenty = settings()
    for values in [*twenty.problem.arms.values(), *(twenty.space.from_unit([k / 7] * 15) for k in range(8))]:
        config: Any = twenty.problem.config(values)
        assert config.seed.total + config.adaptive_budget == 20


def test_what_the_user_sets_is_the_default_and_is_checked() -> None:
    """An override of a tuned parameter is no longer ignored where the space has a default of its own."""
    assert settings(overrides={**TWENTY, "pool.max_elevation_deg": 30.0}).problem.default[
        "pool.max_elevation_deg"
    ] == pytest.approx(30.0)
    with pytest.raises(UserError, match=r"seed\.lowest_deg has the default 80"):
        settings(overrides={**TWENTY, "seed.lowest_deg": 80.0})


@pytest.mark.parametrize("budget", [6, 16, 24])
def test_a_resume_has_the_same_plain_plans(budget: int) -> None:
    """``campaign.yaml`` has the length of the whole design, which must not make room for further blocks."""
    begun = settings(budget=budget, sampler="random")
    assert settings_from_dict(begun.to_dict(), "campaign.yaml").search == begun.search


def test_a_beginning_that_the_settings_exclude_is_left_out() -> None:
    """A ring at 6 degrees lies at 1.2 m."""
    own = {"seed.layout": "turn", "seed.lowest_deg": 6.0}
    space = dataclasses.replace(load_search_space("plan_and_gate"), begin=(own,))
    low = settings(space=space, overrides={})
    high = settings(space=space, overrides={"flight.min_camera_altitude_m": 1.3})
    assert low.problem.space.begin == (own,) and high.problem.space.begin == ()


def test_every_plain_plan_runs_on_the_same_blocks_the_default_first(campaign: Campaign) -> None:
    s = campaign.settings
    assert list(s.problem.arms) == ["orbit-middle", "orbit-high", "random", "hyb-h"]
    blocks: dict[str, list[Any]] = {}
    for p in s.search.arms:
        blocks.setdefault(p.metadata["arm"], []).append((p.instance, p.replicate))
    assert list(blocks) == ["hyb-h", "orbit-middle", "orbit-high", "random"]
    assert all(own == blocks["hyb-h"] for own in blocks.values()) and len(blocks["hyb-h"]) == 3
    first = campaign.trials()[: len(s.search.arms)]
    assert [dict(t.values) for t in first[:2]] == [s.problem.arms["hyb-h"], s.problem.arms["orbit-middle"]]


def test_what_nothing_reads_is_at_its_default() -> None:
    space = settings().space
    default = settings().problem.default
    orbit = space.settled({**default, "seed.count": 20, "covis.weights.nov": 0.5, "gate.kind": "random"})
    assert orbit == {**default, "seed.count": 20}
    at_random = space.settled({**default, "gate.kind": "random", "gate.d95_m": 0.5})
    assert at_random == {**default, "gate.kind": "random"}


def recommended(
    extra: Mapping[str, tuple[Values, float]],
    arms: Mapping[str, float],
    gains: Any = (),
    failing: Mapping[str, str] = {},
) -> Any:
    """After missions on three rocks and two replicates: of the plain plans with these means, and of other configurations.

    ``gains``: of the orbit at 20°, rock by rock; ``failing``: rocks and replicates on which a plan fails.
    """
    s, observations = settings(rocks=("a", "b", "c")), list[Observation]()
    plans = {name: (s.problem.arms[name], mean) for name, mean in arms.items()} | dict(extra)
    wobble = [0.06, -0.04, 0.05, -0.05]
    for name, (values, mean) in plans.items():
        for k, (rock, replicate) in enumerate(itertools.product("abc", (0, 1))):
            y = mean + wobble[(k + len(observations)) % 4] + (2.0 if rock == "b" else 0.0)
            y += gains["abc".index(rock)] if gains and name == "orbit-high" else 0.0
            ended = (None, None, "sfm") if f"{rock}{replicate}" in failing.get(name, "") else (y, y)
            observations.append(Observation(len(observations), values, rock, replicate, *ended))
    best = recommend(s.problem, s.goal, observations)
    return s, best


ARMS = {"orbit-middle": 97.0, "orbit-high": 96.0, "random": 95.0, "hyb-h": 90.0}


def test_a_plan_that_an_orbit_beats_is_not_recommended_and_a_better_one_is() -> None:
    tried = {**settings().problem.default, "seed.count": 18}
    s, best = recommended({"tried": (tried, 97.0)}, ARMS)
    assert best.plain == best.best_plain.strategy == "orbit-middle" and best.best_plain.gain == 0.0
    assert best.improvement == pytest.approx(7.0, abs=0.5)
    assert use_sentence(best, s).startswith("Fly the orbit: 20 photographs at 15°")
    best = recommended({"tried": (tried, 99.0)}, ARMS)[1]
    assert best.plain == "" and best.values == tried and best.best_plain.interval_95[0] > 0


def test_the_first_orbit_gives_way_to_one_that_is_better_everywhere_or_where_it_fails() -> None:
    # A gain on two of three rocks does not tell which orbit is the better one on others.
    near = recommended({}, {**ARMS, "random": 97.1, "hyb-h": 96.9}, gains=(2.0, 0.3, 2.5))[1]
    assert (near.plain, near.best_plain.strategy) == ("orbit-middle", "orbit-high")
    assert near.best_plain.gain < 0
    assert recommended({}, ARMS, gains=(2.4, 2.5, 2.6))[1].plain == "orbit-high"
    assert recommended({}, ARMS, failing={"orbit-middle": "c0 c1"})[1].plain == "orbit-high"
    assert recommended({}, ARMS, failing={"orbit-middle": "c0"})[1].plain == "orbit-middle"  # by chance


def test_what_fails_more_often_than_a_plain_plan_is_not_recommended() -> None:
    tried = {**settings().problem.default, "seed.count": 18}
    failing = {"tried": "a0 b1 c0"}
    assert recommended({"tried": (tried, 99.0)}, ARMS, failing=failing)[1].plain == "orbit-middle"


def test_the_orbit_is_exported_as_settings_and_as_a_route(
    gatetune: Any, campaign: Campaign, tmp_path: Path
) -> None:
    out = tmp_path / "orbit.yaml"
    asked = ["export", campaign.directory, "--strategy", "orbit"]
    gatetune.ok(*asked, "--to", "gatetune.yaml", "--out", out)
    config = config_from_dict(yaml.safe_load(out.read_text()))
    assert (config.seed.count, config.seed.lowest_deg, config.adaptive_budget) == (20, 10.0, 0)
    route = tmp_path / "orbit.plan"
    said = gatetune.ok(*asked, "--to", "plan", "--home", "33.4,-111.9", "--out", route)
    items = json.loads(route.read_text())["mission"]["items"]
    assert sum(item["command"] == 2000 for item in items) == 20  # photographs
    assert "target 1.6 m high" in said
    asked[-1] = "spiral"
    assert "orbit-high" in gatetune.refused(*asked, "--to", "gatetune.yaml")
    asked[-1] = "random"  # the route of planned views
    assert "hold for one target" in gatetune.refused(*asked, "--to", "plan", "--home", "33.4,-111.9")


def test_one_advice_for_status_and_json(gatetune: Any, campaign: Campaign) -> None:
    advice = advice_of(campaign, campaign.recommended())
    assert not advice.results.held_out
    tree = json.loads(gatetune.ok("campaign", "status", campaign.directory, "--json"))
    assert tree["status"]["finished"] + tree["status"]["repeats"] == tree["status"]["trials"]
    shown = gatetune.ok("campaign", "status", campaign.directory)
    exported = gatetune.ok("export", campaign.directory)
    for sentence in tree["advice"]:
        assert sentence[:40] in shown.replace("\n", " ") and sentence[:40] in exported.replace("\n", " ")


def test_a_plain_plan_that_is_recommended_shares_its_results(
    campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A confirmation runs fresh replicates of the recommendation, under that name alone."""
    s = campaign.settings
    best = dataclasses.replace(campaign.recommended(), values=s.problem.arms["orbit-middle"])
    fresh = made_trial(TUNED, "a", 7, measured={"metrics": made_metrics(90.0)})
    confirmed = SimpleNamespace(strategies={TUNED: s.problem.config(best.values)}, records=lambda _: [fresh])
    monkeypatch.setattr("tuner.comparison.result.evaluations", lambda *_: [(Path(), confirmed)])
    records = training_results(campaign, best).records
    own, twin = ({(r.rock, r.replicate) for r in records if r.strategy == n} for n in (TUNED, "orbit-middle"))
    assert own == twin and ("a", 7) in twin


def test_plans_that_ran_on_other_rocks_are_compared_where_both_ran(
    campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second evaluation runs the recommended orbit, not its twin among the plain plans, on a harder rock."""
    best = campaign.recommended()
    twin = {**campaign.settings.problem.arms, best.plain: best.values}
    configs = {name: campaign.settings.problem.config(values) for name, values in twin.items()}
    configs[TUNED] = configs[best.plain]
    scores = {"easy": {TUNED: 99.0, best.plain: 99.0, "random": 99.2}, "hard": {TUNED: 80.0, "random": 81.0}}
    records = [
        made_trial(name, rock, 0, measured={"metrics": made_metrics(score)})
        for rock, of in scores.items()
        for name, score in of.items()
    ]
    results = Results(True, records, configs, True, campaign.settings)
    monkeypatch.setattr("tuner.comparison.advice.held_out_results", lambda *_: results)
    advice = advice_of(campaign, best)
    assert advice.plain == "random" and advice.over_plain is not None and advice.over_plain.gain is not None
    assert advice.over_plain.gain.mean == pytest.approx(-0.6)
    unpaired = made_trial(TUNED, "third", 0, measured={"metrics": made_metrics(70.0)})
    results = Results(True, [*records, unpaired], configs, True, campaign.settings)
    advice = advice_of(campaign, best)
    assert "On 2 held-out rocks it has" in " ".join(advice_lines(advice, best, campaign.settings))
    assert next_step(campaign, best, advice) is Next.MORE_INSTANCES


def test_an_evaluation_under_other_conditions_does_not_count(campaign: Campaign) -> None:
    for name, says in {"harsh": "for ideal, where it was tuned", "ideal": ""}.items():
        conditions = tuple(load_conditions([name]))
        plan = EvaluationPlan({TUNED: campaign.recommended_config()}, ("arch",), conditions=conditions)
        usual = campaign.directory / "evaluation"
        why = PlannedComparison(plan, TUNED, "", usual, source=campaign).not_counted(usual)
        assert says in why and bool(says) == bool(why)


def test_a_plan_without_a_record_adds_no_strategy(
    campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    tuned = campaign.recommended_config()
    records = {TUNED: [made_trial(TUNED, "arch", 0)], "random": []}
    plans = [
        SimpleNamespace(fidelity="", combinations=1, strategies={name: tuned}, records=lambda _, of=of: of)
        for name, of in records.items()
    ]
    monkeypatch.setattr("tuner.comparison.result.evaluations", lambda *_: [(Path(), p) for p in plans])
    found = held_out_results(campaign, tuned)
    assert found is not None and list(found.strategies) == [TUNED] and found.complete


def test_the_list_of_campaigns_names_what_is_advised(
    gatetune: Any, campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The recommendation of the campaign is not what to fly where a plain plan beats it on held-out rocks."""
    problem = campaign.settings.problem
    plans = {**problem.arms, TUNED: campaign.recommended().values}
    configs = {name: problem.config(values) for name, values in plans.items()}
    records = [
        made_trial(name, rock, 0, measured={"metrics": made_metrics(score + k / 10)})
        for k, rock in enumerate("abcd")
        for name, score in {TUNED: 95.0, "random": 97.0}.items()
    ]
    results = Results(True, records, configs, True, campaign.settings)
    monkeypatch.setattr("tuner.comparison.advice.held_out_results", lambda *_: results)
    (listed,) = json.loads(gatetune.ok("campaign", "list", campaign.directory.parent, "--json"))
    assert listed["answer"].startswith("Fly Random views ("), listed
    assert "so its intervals are optimistic." in gatetune.ok("campaign", "status", campaign.directory)
    out = ("--to", "gatetune.yaml", "--out", "plan.yaml")
    orbit = problem.config(problem.arms["orbit-high"]).with_values({"seed.count": 18})
    results.strategies["orbit-high-18"] = orbit  # what was evaluated is exported, not another of that name
    gatetune.ok("export", campaign.directory, "--strategy", "orbit-high", *out)
    assert (
        yaml.safe_load(Path("plan.yaml").read_text())["seed"]["count"]
        == problem.arms["orbit-high"]["seed.count"]
    )
    gatetune.ok("export", campaign.directory, "--strategy", "orbit-high-18", *out)
    assert yaml.safe_load(Path("plan.yaml").read_text())["seed"]["count"] == 18


def test_what_rounds_to_nothing_changes_no_advice_and_the_oracle_s_points_are_points(
    campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, best = campaign.settings.problem, campaign.recommended()
    plans = {**problem.arms, TUNED: best.values}
    configs = {name: problem.config(values) for name, values in plans.items()}
    configs["greedy-oracle"] = configs["random"]
    scores = {TUNED: 95.0, "random": 95.04, "greedy-oracle": 99.0}
    records = [
        made_trial(
            name, rock, 0, measured={"metrics": made_metrics(score + k / 10), "costs": {"images": 20.0}}
        )
        for k, rock in enumerate("abcd")
        for name, score in scores.items()
    ]
    results = Results(True, records, configs, True, campaign.settings)
    monkeypatch.setattr("tuner.comparison.advice.held_out_results", lambda *_: results)
    advice = advice_of(campaign, best)
    assert advice.over_plain is not None and advice.over_plain.kind is Kind.WORSE
    assert advice.fly == TUNED and advice.ceiling is not None
    goal = dataclasses.replace(campaign.settings, objective=Objective("costs.images", "minimise"))
    monkeypatch.setattr(campaign, "settings", goal)
    assert advice_of(campaign, best).ceiling is None


def test_an_advised_orbit_that_the_space_does_not_hold_is_exported_whole(
    gatetune: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = fake_campaigns.run(tmp_path / "run", space=load_search_space("gate"), budget=8, replicates=2)
    orbit = baseline("orbit").orbit(run.settings.problem.base, 32)
    advice = advice_of(run, run.recommended())
    beaten = dataclasses.replace(advice, fly="orbit-32", plain="orbit-32", config=orbit)
    monkeypatch.setattr("tuner.commands.export.advice_of", lambda *_: beaten)
    out = tmp_path / "orbit.yaml"
    said = gatetune.ok("export", run.directory)
    assert "seed.count 32 (default 0)" in said
    asked = ("export", run.directory, "--to", "gatetune.yaml", "--out", out)
    gatetune.ok(*asked)
    assert config_from_dict(yaml.safe_load(out.read_text())) == orbit
    assert "carries none of the changes" in gatetune.refused("export", run.directory, "--to", "scoring.yaml")
    gatetune.ok("export", run.directory, "--to", "unified_mission.yaml")
    theirs = read_file(run.directory / "unified_mission.yaml", "unified_mission.yaml")
    assert (theirs["seed_elevation_rings_deg"], theirs["image_budget"]) == ([10.0], 0)
    gatetune.ok(*asked, "--strategy", "tuned")
    assert config_from_dict(yaml.safe_load(out.read_text())) == run.recommended_config()
