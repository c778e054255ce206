import dataclasses
import json
from pathlib import Path
from typing import Any

import pytest

from nbv.errors import UserError
from nbv.geometric import run_geometric_mission
from nbv.rocks.recipes import RECIPES
from tuner.campaign.begin import begin_campaign
from tuner.campaign.settings import CampaignSettings
from tuner.campaign.shipped import DIRECTORY, SHIPPED, shipped_missions, sources_by_default
from tuner.problem.objective import Objective
from tuner.problem.space_files import load_search_space

FULL = load_search_space("full")


@pytest.mark.parametrize("name", sorted(path.stem for path in DIRECTORY.glob("*.json")))
def test_they_fit_their_space_and_use_procedural_training_rocks(name: str) -> None:
    earlier = shipped_missions(load_search_space(name), Objective())
    assert sum(o.feasible for o in earlier.observations) >= 90
    assert {RECIPES[rock].split for rock in earlier.rocks} == {"train"}
    tree = json.loads((DIRECTORY / f"{name}.json").read_text())
    assert "--fidelity geometric" in tree["flown_by"] and "--learn-from nothing" in tree["flown_by"]


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(path.stem for path in DIRECTORY.glob("*.json")))
def test_a_mission_of_today_gives_what_is_recorded(name: str) -> None:
    """Fails when missions have changed: then run the campaign again (research/ship_missions.py)."""
    space = load_search_space(name)
    earlier = shipped_missions(space, Objective())
    config = CampaignSettings(space=space, rocks=("x",)).problem.config
    on_one_rock = [o for o in earlier.observations if o.rock == "cavern" and o.raw is not None]
    best = max(on_one_rock, key=lambda o: o.raw or 0.0)
    for each in (on_one_rock[0], best):
        evaluated = run_geometric_mission(config(each.values), each.rock, each.replicate)
        assert Objective().measure(evaluated.metrics) == pytest.approx(each.raw, abs=0.05)


def test_learning_from_them_needs_their_space_and_metric(tmp_path: Path) -> None:
    settings = CampaignSettings(space=FULL, rocks=("boulder",), budget=12, learn_from=(SHIPPED,))
    learned = begin_campaign(tmp_path / "run", settings).learned
    assert learned is not None and set(learned.rocks) == {"slab", "vesicular", "breccia", "cavern"}
    assert settings.initial_size() == 5  # a third of the budget, and the default once more
    other = dataclasses.replace(FULL, parameters=FULL.parameters[:-1])
    narrow = dataclasses.replace(FULL.parameters[0], high=0.9)
    narrower = dataclasses.replace(FULL, parameters=(narrow, *FULL.parameters[1:]))
    asked = [(space, Objective()) for space in (narrower, other, load_search_space("gate"))]
    asked += [(FULL, Objective("observable.f_score_16mm")), (FULL, Objective(direction="minimise"))]
    for space, objective in asked:
        assert sources_by_default(space, objective, "gp", None) == ()
        with pytest.raises(
            UserError, match=f"for search space '{space.name}'.* leave `--learn-from shipped`"
        ):
            shipped_missions(space, objective)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, (SHIPPED,)),
        ({"learn_from": ("nothing",)}, ()),
        ({"sampler": "tpe"}, ()),
        ({"objective": Objective("observable.completeness_48mm")}, ()),
        ({"second": Objective("costs.flight_time_s", "minimise"), "limit": 300.0}, ()),
    ],
)
def test_a_campaign_in_their_space_learns_from_them_unless_told(
    changes: dict[str, Any], expected: tuple[str, ...]
) -> None:
    assert CampaignSettings(space=FULL, rocks=("boulder",), **changes).sources == expected
