"""One answer from all missions: who chose them, what was tuned, what to fly, and the same on every screen."""

import shutil
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import fake_campaigns
import numpy as np
import pytest
from made_evaluations import made_metrics, made_trial
from refusals import refused
from scoring_state import few_seeds

from nbv.config import MissionConfig, SeedConfig, preset
from nbv.viewpoints import seed_viewpoints
from tuner.answer.answer import answer_of, flight_of, next_step, table_of
from tuner.answer.evidence import Evidence, evidence_of, kind_of_target
from tuner.campaign.campaign import Campaign
from tuner.campaign.settings import CampaignSettings
from tuner.campaign.settings_file import settings_from_dict
from tuner.problem.baselines import PAPER_STRATEGIES, ablations, baseline
from tuner.problem.goal import Objective
from tuner.problem.search_space import LEAST_PLANNED, TUNED_GATE, TUNED_PLANNER
from tuner.problem.space_files import load_search_space
from tuner.report.words import sentences

TWENTY = {"photographs": 20, "seeds": 12, "sparse.ground_features": 2000}


def settings(**changes: object) -> CampaignSettings:
    asked = {"space": load_search_space("plan_and_gate"), "overrides": TWENTY, "budget": 30, "replicates": 1}
    return fake_campaigns.settings(**{**asked, "rocks": ("a", "b", "c"), **changes})


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    asked = {"space": load_search_space("plan_and_gate"), "overrides": TWENTY, "rocks": ("a", "b", "c")}
    return fake_campaigns.run(tmp_path_factory.mktemp("c") / "run", budget=30, **asked)


# -- the space and its regions ---------------------------------------------------------------------------------


def test_the_default_is_the_papers_plan_and_all_take_as_many_photographs() -> None:
    assert seed_viewpoints(settings(overrides={}).problem.base) == seed_viewpoints(preset("campaign"))
    problem = settings().problem
    assert [n for _, n in problem.base.seed_rings] == [4, 3, 3, 2] and problem.base.seed.radius_m == 4.0
    rng = np.random.default_rng(0)
    for unit in rng.random((8, problem.space.dimension)):
        config = problem.config(problem.space.from_unit(unit))
        assert config.photographs == 20


def test_regions_hold_what_they_say() -> None:
    """A projection lies in the region and moves nothing that lies there."""
    problem, rng = settings().problem, np.random.default_rng(1)
    gate, planner = problem.answers
    assert (gate.name, planner.name) == (TUNED_GATE, TUNED_PLANNER)
    for unit in rng.random((20, problem.space.dimension)):
        for region in problem.answers:
            values = problem.space.from_unit(region.project(unit))
            assert region.contains(values)
            settled = problem.space.to_unit(values)
            np.testing.assert_allclose(region.project(settled), settled, atol=1e-12)
        at_gate = problem.config(problem.space.from_unit(gate.project(unit)))
        assert (at_gate.seed, at_gate.pool) == (problem.base.seed, problem.base.pool)
        assert problem.config(problem.space.from_unit(planner.project(unit))).planned_views >= LEAST_PLANNED


def test_spaces_have_the_answers_that_they_can_give() -> None:
    def answers(name: str, **changes: object) -> list[str]:
        s = fake_campaigns.settings(space=load_search_space(name), **changes)
        return [region.name for region in s.problem.answers]

    assert answers("gate_and_weights") == [TUNED_GATE]
    assert answers("gate_weights_and_pool") == [TUNED_GATE, TUNED_PLANNER]
    limited = {"objective": Objective("costs.images", "minimise"), "second": Objective(), "limit": 97.0}
    assert answers("photographs") == answers("gate", **limited) == ["tuned"]


# -- who flies what --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [16, 20, 32])
def test_the_papers_strategies_fly_the_papers_rings(number: int) -> None:
    """Whatever the seeds of the campaign are: shares of 8 : 6 : 6 : 4 at 4 m."""
    ring = few_seeds(number - 8, lowest_deg=10.0, radius_m=3.5)
    base = preset("campaign").with_values({"photographs": number, **ring})
    for name in PAPER_STRATEGIES:
        config = baseline(name).config(base)
        assert config.seed == SeedConfig() and config.seeds == base.seeds
    assert baseline("random").config(base).seed == base.seed


def test_the_model_chooses_at_least_half_of_the_missions(campaign: Campaign) -> None:
    chosen = answer_of(campaign).chosen_by
    assert 30 <= sum(chosen.values()) <= 33
    assert chosen["model"] >= 15 and chosen["baselines"] <= 7 and chosen["verification"] <= 3
    gate = campaign.recommended()[TUNED_GATE].values
    assert len({t.rock for t in campaign.trials() if t.values == gate}) >= 2


@pytest.mark.parametrize("budget", [6, 16, 24])
def test_a_resume_has_the_same_baselines(budget: int) -> None:
    """``campaign.yaml`` has the length of the whole design, which must not make room for further blocks."""
    begun = settings(budget=budget, sampler="random")
    assert settings_from_dict(begun.to_dict(), "campaign.yaml").search == begun.search


def test_baselines_run_on_the_same_blocks(campaign: Campaign) -> None:
    blocks: dict[str, list[Any]] = {}
    for p in campaign.settings.search.arms:
        blocks.setdefault(p.metadata["arm"], []).append((p.instance, p.replicate))
    assert list(blocks) == ["hyb-h", "orbit-middle"] and blocks["hyb-h"] == blocks["orbit-middle"]


def test_an_ablation_puts_one_group_back() -> None:
    base = settings().problem.base
    tuned = base.with_values({"gate.geometry_scorer": "predicted", "covis.weights.nov": 0.1, "seeds": 14})
    found = ablations("tuned-planner", tuned, base)
    assert list(found) == [f"tuned-planner-without-{group}" for group in ("scorer", "weights", "seeds")]
    assert found["tuned-planner-without-seeds"].seeds == base.seeds
    assert found["tuned-planner-without-scorer"].gate == base.gate
    assert not ablations("tuned-gate", base.with_values({"gate.d95_m": 0.3}), base)


# -- what to fly -----------------------------------------------------------------------------------------------


def evidence(scores: Mapping[str, Mapping[str, float | None]], held_out: str = "") -> Evidence:
    """Missions with these F-scores by strategy and target; None is a failed mission."""
    problem = settings().problem
    planner = problem.config({**problem.default, "gate.geometry_scorer": "predicted"})
    configs: dict[str, MissionConfig] = {
        name: planner if name.startswith("tuned") else baseline(name).config(problem.base) for name in scores
    }
    records = [
        made_trial(name, target, 0, reason="sfm", status="failed")
        if score is None
        else made_trial(
            name, target, 0, measured={"metrics": made_metrics(score - 3.0), "costs": {"images": 20}}
        )
        for name, of in scores.items()
        for target, score in of.items()
    ]
    return Evidence(configs, records, frozenset("abcdef") - frozenset(held_out), Objective())


def fly(campaign: Campaign, scores: Mapping[str, Mapping[str, float | None]]) -> Any:
    return flight_of(evidence(scores), campaign.recommendations(save=False), 20)


EVEN = {"a": 96.0, "b": 97.0, "c": 95.0, "d": 96.5}


def plus(gains: Mapping[str, float]) -> dict[str, float | None]:
    return {target: EVEN[target] + gain for target, gain in gains.items()}


def test_what_is_shown_to_be_better_is_flown_and_a_tie_goes_to_the_simplest(campaign: Campaign) -> None:
    better = plus({"a": 1.0, "b": 1.2, "c": 0.9, "d": 1.1})
    flown = fly(campaign, {"orbit-middle": EVEN, TUNED_PLANNER: better})
    assert flown.strategy == TUNED_PLANNER and flown.shown and not flown.leads
    unsure = plus({"a": 6.0, "b": -1.0, "c": 0.5, "d": 0.0})
    flown = fly(
        campaign, {"orbit-middle": EVEN, "hyb-h": plus(dict.fromkeys(EVEN, -5.0)), TUNED_PLANNER: unsure}
    )
    assert flown.strategy == "orbit-middle" and list(flown.leads) == [TUNED_PLANNER]
    assert flown.leads[TUNED_PLANNER].mean == pytest.approx(1.375)
    tiny = plus(dict.fromkeys(EVEN, 0.000005))
    assert fly(campaign, {"orbit-middle": EVEN, TUNED_PLANNER: tiny}).strategy == "orbit-middle"


@pytest.mark.parametrize(
    ("lead", "targets", "says"), [(0.4, 3, "export"), (1.5, 3, "evaluate"), (1.5, 99, "export")]
)
def test_a_lead_that_is_not_shown_is_worth_more_targets(campaign, lead, targets, says) -> None:
    drawn = campaign.held_out()[:targets]
    gate = {rock: 85.0 + lead + (5.0, -5.0, 0.0)[k % 3] for k, rock in enumerate(drawn)}
    found = evidence({"orbit-middle": dict.fromkeys(drawn, 85.0), TUNED_GATE: gate})
    advice = flight_of(found, recommendations := campaign.recommendations(save=False), 20)
    assert advice is not None and advice.strategy == "orbit-middle"
    step = next_step(campaign, recommendations, [table_of(found, True, "orbit-middle", 20)], advice)
    assert step.command.split()[1] == says


def test_a_tuned_plan_has_to_be_better_than_the_best_plain_one(campaign: Campaign) -> None:
    """Between the two orbits, and between the better one and the tuned plan, nothing is shown."""
    high, gate = ({"a": 1.5, "b": 0.2, "c": 1.9, "d": 0.1}, dict.fromkeys(EVEN, 1.0))
    scores = {"orbit-middle": EVEN, TUNED_GATE: plus(gate)}
    assert fly(campaign, scores).strategy == TUNED_GATE
    assert fly(campaign, {**scores, "orbit-high": plus(high)}).strategy == "orbit-high"


def test_plans_are_compared_on_missions_that_both_flew(campaign: Campaign) -> None:
    """One more, easy target of another plan changes nothing."""
    better = plus(dict.fromkeys("abc", 1.0)) | {"d": 97.7}
    scores = {
        "orbit-middle": EVEN,
        "orbit": {**plus(dict.fromkeys("abc", -0.4)), "easy": 100.0},
        TUNED_PLANNER: better,
    }
    assert fly(campaign, scores).strategy == TUNED_PLANNER
    scores.pop(TUNED_PLANNER)
    assert fly(campaign, scores).strategy == "orbit-middle"


def test_a_failed_mission_counts_as_nothing_scored(campaign: Campaign) -> None:
    failing: dict[str, float | None] = {**plus(dict.fromkeys(EVEN, 2.0)), "a": None, "b": None}
    found = evidence({"orbit-middle": EVEN, TUNED_PLANNER: failing})
    gain = found.gain(TUNED_PLANNER, "orbit-middle")
    assert gain is not None and gain.mean == pytest.approx((-96.0 - 97.0 + 2.0 + 2.0) / 4)
    assert fly(campaign, {"orbit-middle": EVEN, TUNED_PLANNER: failing}).strategy == "orbit-middle"
    (row,) = [r for r in table_of(found, False, "hyb-h", 20).rows if r.strategy == TUNED_PLANNER]
    assert (row.failures, row.missions) == (2, 4)


def test_two_targets_have_no_interval_over_targets(campaign: Campaign) -> None:
    two = {"a": 96.0, "b": 97.0}
    scores = {"orbit-middle": two, TUNED_PLANNER: {"a": 97.0, "b": 98.1}}
    gain = evidence(scores).gain(TUNED_PLANNER, "orbit-middle")
    assert gain is not None and gain.low is None
    assert fly(campaign, scores).strategy == "orbit-middle"


def test_the_table_has_a_column_for_each_kind_of_target() -> None:
    assert [kind_of_target(name) for name in ("part-20003", "slab", "cleft-7")] == [
        "shapes",
        "rocks",
        "rocks",
    ]
    scores = {"hyb-h": {"slab": 90.0, "part-5": 70.0}, "orbit-middle": {"slab": 98.0, "part-5": 80.0}}
    table = table_of(evidence(scores), True, "hyb-h", 20)
    row = next(r for r in table.rows if r.strategy == "orbit-middle")
    assert table.kinds == ("rocks", "shapes") and row.means == {"all": 89.0, "rocks": 98.0, "shapes": 80.0}
    assert row.from_reference is not None and row.from_reference.mean == 9.0
    assert table.best_plain == "orbit-middle" and row.from_baseline is None


# -- the same everywhere ---------------------------------------------------------------------------------------


def test_the_surrogate_is_asked_from_python(campaign: Campaign) -> None:
    mean, low, high = campaign.predict({"gate.geometry_scorer": "predicted"})
    assert low < mean < high
    refused("not in the search space", campaign.predict, {"gate.kind": "random"})
    refused(r"seeds is 400", campaign.predict, {"seeds": 400})


def test_an_evaluation_of_an_earlier_recommendation_counts_for_the_baselines_alone(campaign, monkeypatch):
    problem, found = campaign.settings.problem, campaign.recommendations(save=False)
    old = problem.config({**problem.default, "gate.d95_m": 0.77})
    orbit = baseline("orbit").config(problem.base)

    strategies = {TUNED_PLANNER: old, "orbit": orbit}
    records = [made_trial(name, "arch", 0, measured={"metrics": made_metrics(90.0)}) for name in strategies]
    fidelity = campaign.settings.fidelity
    plan = SimpleNamespace(strategies=strategies, fidelity=fidelity, records=lambda _: records)
    monkeypatch.setattr("tuner.answer.evidence._plans", lambda *_: [(Path(), plan)])
    on_arch = [r.strategy for r in evidence_of(campaign, found).records if r.rock == "arch"]
    assert on_arch == ["orbit"]


def test_an_evaluation_that_cannot_be_read_is_named(campaign: Campaign) -> None:
    plan = campaign.directory / "evaluation-9" / "evaluation.yaml"
    plan.parent.mkdir()
    plan.write_text("format: [")
    said = [line for line in sentences(answer_of(campaign)) if "evaluation-9" in line]
    shutil.rmtree(plan.parent)
    assert len(said) == 1 and "is left out" in said[0]
