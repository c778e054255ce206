"""Sensitivity of a surrogate to known functions."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import fake_campaigns
import numpy as np
import pytest

from nbv.errors import UserError
from nbv.types import Floats
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation
from tuner.problem.search_space import SearchSpace
from tuner.problem.space_files import load_search_space
from tuner.studies.sensitivity import Sensitivity, sensitivity, write_sensitivity

SPACE = load_search_space("gate_and_weights")
GATE = load_search_space("gate")
ROCKS = {"r0": 0.0, "r1": 30.0, "r2": -10.0}


def of(
    function: Callable[[Floats], float], space: SearchSpace = SPACE, count: int = 60, noise_sd: float = 0.1
) -> Sensitivity:
    """Missions of a known function of the unit cube on rocks of different difficulty."""
    rng, missions = np.random.default_rng(0), []
    for i in range(count):
        values = space.from_unit(rng.random(space.dimension))
        rock = list(ROCKS)[i % len(ROCKS)]
        y = ROCKS[rock] + function(space.to_unit(values)) + noise_sd * rng.normal()
        missions.append(Observation(i, values, rock, 0, y, y))
    return sensitivity(space, missions, Objective())


@pytest.mark.slow
def test_an_additive_function_is_attributed_to_its_inputs(tmp_path: Path) -> None:
    """Nine tenths of the variance from the fourth parameter, one tenth from the first."""
    found = of(lambda u: 3 * u[3] + 1 * u[0])
    by_path = {item.path: item for item in found.importances}
    strong, weak = by_path[SPACE.paths[3]], by_path[SPACE.paths[0]]
    assert [item.path for item in found.importances[:2]] == [strong.path, weak.path]
    assert strong.first == pytest.approx(0.9, abs=0.06) and strong.total == pytest.approx(0.9, abs=0.06)
    assert weak.first == pytest.approx(0.1, abs=0.05)
    assert all(item.total < 0.03 for item in found.importances[2:])
    assert strong.total_95[0] < 0.9 < strong.total_95[1]
    assert found.explained > 0.8 and found.caution == ""
    assert found.signal_sd == pytest.approx(np.sqrt(10 / 12), rel=0.15)
    assert found.noise_sd == pytest.approx(0.1, rel=1.0)
    # Rock offsets of 30 would drown everything if outcomes were not standardised per rock.
    shares = {item.path: item.optuna or 0.0 for item in found.importances}
    assert max(shares, key=shares.__getitem__) == strong.path
    assert sum(shares.values()) == pytest.approx(1.0, abs=1e-6)
    report = write_sensitivity(found, tmp_path)
    assert f"{strong.total:.2f}" in report.read_text()
    assert (tmp_path / "importance.png").stat().st_size > 10_000
    tree = json.loads((tmp_path / "sensitivity.json").read_text())
    assert tree["importances"][0]["total"] == pytest.approx(strong.total)


@pytest.mark.slow
def test_a_pure_interaction_is_found() -> None:
    found = of(lambda u: 8 * (u[0] - 0.5) * (u[1] - 0.5), GATE, 48, 0.02)
    assert all(item.first < 0.15 and item.total > 0.8 for item in found.importances)


def test_too_few_missions_are_refused() -> None:
    with pytest.raises(UserError, match="at least 18"):
        of(lambda u: float(u[0]), count=12)


@pytest.mark.slow
def test_the_command_takes_a_campaign_apart(gatetune, tmp_path: Path) -> None:
    fake_campaigns.run(tmp_path / "run", sampler="sobol", budget=12)
    code, out, _ = gatetune("study", "sensitivity", "run")
    assert code == 0 and "12 missions on 2 rocks" in out
    tree = json.loads((tmp_path / "run" / "sensitivity" / "sensitivity.json").read_text())
    assert {p["path"] for p in tree["importances"]} == set(fake_campaigns.settings().space.paths)
    code, _, err = gatetune("study", "sensitivity", "nowhere")
    assert code == 2 and "nowhere" in err
