"""Sensitivity of a surrogate to known functions, and where its missions come from."""

from __future__ import annotations

import json

import numpy as np
import pytest
import yaml
from fake_study import fake_study_mission

from nbv.config import MissionConfig
from nbv.errors import UserError
from tuner.campaign.begin import begin_campaign
from tuner.campaign.session import fly_campaign
from tuner.campaign.settings import CampaignSettings
from tuner.missions.executors import InProcessExecutor
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation
from tuner.problem.space_files import load_search_space, space_from_dict
from tuner.studies.missions_as_data import MissionData, campaign_data, find_missions, mission_data
from tuner.studies.sensitivity.report import write_sensitivity_report
from tuner.studies.sensitivity.study import Surrogate, sensitivity, settle
from tuner.surrogate.model import RockMeanGP

METRIC = "agreement.5.observable.f_score_48mm"
SPACE = load_search_space("gate_and_weights")
GATE = load_search_space("gate")
ROCKS = {"r0": 0.0, "r1": 30.0, "r2": -10.0}


def data(function, space=SPACE, count=60, noise_sd=0.1, direction="maximise"):
    """Missions of a known function of the unit cube on rocks of different difficulty."""
    rng = np.random.default_rng(0)
    observations = []
    for i in range(count):
        values = space.from_unit(rng.random(space.dimension))
        rock = list(ROCKS)[i % len(ROCKS)]
        y = ROCKS[rock] + function(space.to_unit(values)) + noise_sd * rng.normal()
        objective = Objective("observable.f_score_48mm", direction)
        observations.append(Observation(i, values, rock, 0, objective.sign * y, y))
    return MissionData(space, objective, tuple(observations), {})


@pytest.fixture(scope="module")
def additive():
    """Nine tenths of the variance from the fourth parameter, one tenth from the first."""
    return sensitivity(data(lambda u: 3 * u[3] + 1 * u[0]))


@pytest.mark.slow
def test_an_additive_function_is_attributed_to_its_inputs(additive):
    by_path = {item.path: item for item in additive.importances}
    strong, weak = by_path[SPACE.paths[3]], by_path[SPACE.paths[0]]
    assert [item.path for item in additive.importances[:2]] == [strong.path, weak.path]
    assert strong.first == pytest.approx(0.9, abs=0.06) and strong.total == pytest.approx(0.9, abs=0.06)
    assert weak.first == pytest.approx(0.1, abs=0.05)
    assert all(item.total < 0.03 for item in additive.importances[2:])
    assert strong.first_belief[0] < 0.9 < strong.first_belief[1]
    assert additive.explained > 0.8 and additive.caution == ""
    assert additive.signal_sd == pytest.approx(np.sqrt(10 / 12), rel=0.15)
    assert additive.noise_sd == pytest.approx(0.1, rel=1.0)


@pytest.mark.slow
def test_optunas_importances_agree_on_the_leader(additive):
    """Rock offsets of 30 would drown everything if outcomes were not standardised per rock."""
    for name in ("fanova", "ped_anova"):
        shares = {item.path: getattr(item, name) for item in additive.importances}
        assert max(shares, key=shares.get) == SPACE.paths[3]
        assert sum(shares.values()) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.slow
def test_the_gate_thresholds_are_the_pair(additive):
    assert additive.interaction.paths == ("gate.budget_fraction", "gate.d95_m")
    assert abs(additive.interaction.second) < 0.03
    # Averaged over the rest, the map rises with the first threshold only.
    grid = additive.interaction.mean
    assert np.ptp(grid.mean(axis=1)) == pytest.approx(1.0, abs=0.25) and np.ptp(grid.mean(axis=0)) < 0.15
    assert grid.mean() == pytest.approx(20 / 3 + 2.0, abs=0.3)  # in the metric's unit, mean over the rocks


@pytest.mark.slow
def test_a_pure_interaction_is_found():
    result = sensitivity(data(lambda u: 8 * (u[0] - 0.5) * (u[1] - 0.5), GATE, 48, 0.02))
    assert result.interaction.second > 0.8
    assert result.interaction.second_belief[0] > 0.5
    assert all(item.first < 0.15 and item.total > 0.8 for item in result.importances)


@pytest.mark.slow
def test_noise_alone_is_not_believed():
    result = sensitivity(data(lambda u: 0.0, GATE, 30, 1.0))
    assert "guess" in result.caution or "flat" in result.caution


def test_the_fast_mean_is_the_posteriors():
    space = space_from_dict(
        {
            "name": "mixed",
            "base": {"gate.kind": "hyb-h"},
            "parameters": {
                "gate.budget_fraction": {"low": 0.0, "high": 1.0},
                "b_aware.target_track_length": {"kind": "int", "low": 3, "high": 9},
                "visibility.mode": {"kind": "categorical", "choices": ["frustum", "occlusion"]},
            },
        },
        "test",
    )
    for direction in ("maximise", "minimise"):
        missions = data(lambda u: 2 * u[0] + u[1] - u[2], space, 24, 0.1, direction)
        gp = RockMeanGP(space, missions.observations, missions.rocks)
        surrogate = Surrogate(gp, missions.objective.sign)
        unit = np.random.default_rng(1).random((7, 3))
        expected = gp.posterior([space.from_unit(u) for u in unit]).mean * missions.objective.sign
        assert surrogate.mean(unit) == pytest.approx(expected, abs=1e-6)
        draws = surrogate.draws(unit, 4000, 0)  # standardised: same up to an offset and a factor
        assert np.corrcoef(draws.mean(axis=0), expected)[0, 1] > 0.99
    assert np.array_equal(settle(space, unit)[:, 0], unit[:, 0])
    assert set(settle(space, unit)[:, 2]) <= {0.25, 0.75}


def test_too_few_missions_are_refused():
    with pytest.raises(UserError, match="at least 18"):
        sensitivity(data(lambda u: u[0], count=12))


@pytest.mark.slow
def test_the_report(additive, tmp_path):
    figures = write_sensitivity_report(additive, tmp_path)
    assert [path.name for path in figures] == ["importance.png", "interaction.png"]
    assert all(path.stat().st_size > 10_000 for path in figures)
    tree = json.loads((tmp_path / "sensitivity.json").read_text())
    assert tree["parameters"][0]["total"] == pytest.approx(additive.importances[0].total)
    assert f"{additive.importances[0].total:.2f}" in (tmp_path / "sensitivity.md").read_text()


# -- missions from disk --------------------------------------------------------------------------------------


def write_mission(directory, config, rock="r0", replicate=0):
    directory.mkdir(parents=True)
    result = fake_study_mission(config, rock, replicate, directory)
    (directory / "config.yaml").write_text(yaml.safe_dump(config.to_dict()))
    (directory / "mission.json").write_text(result.to_json())
    return result.metric(METRIC)


def test_missions_of_any_directory_become_observations(tmp_path):
    base = MissionConfig()
    a = base.with_values({"gate.budget_fraction": 0.2})
    written = [write_mission(tmp_path / "a", a), write_mission(tmp_path / "deep" / "b", base, "r1", 2)]
    write_mission(tmp_path / "control", base.with_values({"gate.kind": "random"}))
    write_mission(tmp_path / "outside", base.with_values({"gate.d95_m": 5.0}))
    found = mission_data([tmp_path, tmp_path / "a"], GATE, METRIC)
    assert [o.raw for o in found.observations] == written and found.rocks == ("r0", "r1")
    assert found.observations[0].values == {"gate.budget_fraction": 0.2, "gate.d95_m": 0.14}
    assert found.observations[1].replicate == 2
    assert found.left_out == {
        "differs in what the search space fixes": 1,
        "outside the search space's bounds": 1,
    }
    assert len(find_missions([tmp_path])) == 4


def test_missions_that_differ_elsewhere_are_not_mixed(tmp_path):
    for budget in (8, 16):
        write_mission(tmp_path / f"b{budget}", MissionConfig().with_values({"stop.adaptive_budget": budget}))
    with pytest.raises(UserError, match=r"stop\.adaptive_budget \(16, 8\).*--where stop\.adaptive_budget=16"):
        mission_data([tmp_path], GATE, METRIC)
    found = mission_data([tmp_path], GATE, METRIC, {"stop.adaptive_budget": 8})
    assert len(found.observations) == 1 and found.left_out == {"not what --where asks for": 1}
    with pytest.raises(UserError, match="no mission to learn from"):
        mission_data([tmp_path], GATE, METRIC, {"stop.adaptive_budget": 9})
    with pytest.raises(UserError, match=r"stop\.adaptive_budget"):
        mission_data([tmp_path], GATE, METRIC, {"stop.adaptive_budgett": 9})
    with pytest.raises(UserError, match="no finished mission"):
        mission_data([tmp_path / "nowhere"], GATE, METRIC)


def test_small_distances_are_better(tmp_path):
    write_mission(tmp_path / "a", MissionConfig())
    found = mission_data([tmp_path], GATE, "agreement.5.whole.c2c_mean_mm")
    assert found.objective.direction == "minimise"
    assert found.observations[0].outcome == -found.observations[0].raw


@pytest.mark.slow
def test_a_campaigns_ledger_is_enough(tmp_path):
    settings = CampaignSettings(
        space=GATE,
        rocks=("r0", "r1"),
        budget=8,
        replicates=1,
        sampler="sobol",
        objective=Objective(METRIC),
        fidelity="fake_study:fake_study_mission",
    )
    fly_campaign(begin_campaign(tmp_path / "c", settings), InProcessExecutor())
    tuned = campaign_data(tmp_path / "c")
    assert len(tuned.observations) == 8 and tuned.rocks == ("r0", "r1") and tuned.left_out == {}
    other = campaign_data(tmp_path / "c", "agreement.5.whole.c2c_mean_mm")
    assert [o.raw for o in other.observations] == pytest.approx([100 - o.raw for o in tuned.observations])
    assert other.objective.direction == "minimise"
    assert len(sensitivity(tuned).importances) == 2
