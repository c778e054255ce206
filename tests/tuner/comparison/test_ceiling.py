"""Whether planning pays on an object: what the answer is made of."""

import dataclasses

import pytest

from nbv.errors import UserError
from tuner.comparison.ceiling import Ceiling, ceiling


def test_the_verdict_is_the_oracles_gain_and_names_the_plan_to_fly_where_there_is_none():
    pays = Ceiling("part", 24, "orbit-high", 91.0, 95.5, None)
    assert "up to 4.5 points" in pays.verdict
    even = dataclasses.replace(pays, oracle_percent=90.8)
    assert "0.0 points" in even.verdict and "orbit-high" in even.verdict


def test_an_unknown_mesh_is_said():
    with pytest.raises(UserError, match="no mesh file"):
        ceiling("nowhere/part.stl")
