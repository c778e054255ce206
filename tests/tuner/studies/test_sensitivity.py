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
from tuner.studies.sensitivity import Sensitivity, sensitivity

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
def test_an_additive_function_is_attributed_to_its_inputs() -> None:
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


@pytest.mark.slow
def test_a_pure_interaction_is_found() -> None:
    found = of(lambda u: 8 * (u[0] - 0.5) * (u[1] - 0.5), GATE, 48, 0.02)
    assert all(item.first < 0.15 and item.total > 0.8 for item in found.importances)


def test_too_few_missions_are_refused() -> None:
    with pytest.raises(UserError, match="at least 18"):
        of(lambda u: float(u[0]), count=12)


@pytest.mark.slow
def test_the_command_takes_a_campaign_apart(
    tmp_path: Path, gatetune: Callable[..., tuple[int, str, str]]
) -> None:
    fake_campaigns.run(tmp_path / "run", sampler="sobol", budget=12)
    code, out, _ = gatetune("study", "sensitivity", str(tmp_path / "run"))
    assert code == 0 and "12 missions on 2 rocks" in out
    code, out, _ = gatetune("study", "sensitivity", str(tmp_path / "run"), "--json")
    assert {p["path"] for p in json.loads(out)["importances"]} == set(fake_campaigns.settings().space.paths)
