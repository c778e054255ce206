"""Every fidelity can be found by its name and is called alike."""

from __future__ import annotations

import inspect

import fake_missions
import pytest

from nbv.errors import UserError
from nbv.geometric import run_geometric_mission
from tuner.missions.registry import FIDELITIES, mission_function


@pytest.mark.parametrize("name", [name for name in FIDELITIES if name != "external"])
def test_registered_fidelities_have_one_signature(name: str) -> None:
    assert inspect.signature(mission_function(name)) == inspect.signature(run_geometric_mission)


def test_a_fidelity_of_ones_own_is_named_by_module_and_function() -> None:
    assert mission_function("fake_missions:fake_mission") is fake_missions.fake_mission


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("photogrametric", "unknown fidelity 'photogrametric'; choose from photogrammetric, geometric"),
        ("fake_missions:nothing", "cannot be imported"),
        ("no_such_module:run", "cannot be imported"),
        ("fake_missions:NOISE_SD", "is not a function"),
    ],
)
def test_unknown_fidelities_are_refused_with_a_remedy(name: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        mission_function(name)
