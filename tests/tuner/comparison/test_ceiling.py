"""Whether planning pays on an object: what the answer is made of."""

import dataclasses

import numpy as np
import pytest
import trimesh

from nbv.errors import UserError
from nbv.rocks.rock import make_rock
from tuner.comparison.ceiling import Ceiling, ceiling, pocket_percent


def target(solid):
    solid.apply_translation((0.0, 0.0, 0.5))
    grey = np.full((len(solid.vertices), 3), 128, np.uint8)
    return make_rock("part", solid.vertices, solid.faces, grey, split="extra", difficulty="")


def test_the_surface_of_a_hole_is_counted_and_a_block_has_none():
    assert pocket_percent(target(trimesh.creation.box((1.0, 1.0, 1.0)))) == 0.0
    inner, outer = 2 * np.pi * 0.3, 2 * np.pi * 0.5 + np.pi * (0.5**2 - 0.3**2)  # and the upper face
    ring = target(trimesh.creation.annulus(r_min=0.3, r_max=0.5, height=1.0))
    # The outermost 5 % of the hole, above and below, are not deep enough.
    assert pocket_percent(ring) == pytest.approx(100.0 * 0.9 * inner / (inner + outer), abs=3.0)


def test_the_verdict_is_the_oracles_gain_and_names_the_plan_to_fly_where_there_is_none():
    pays = Ceiling("part", 24, "orbit-high", 91.0, 95.5, 1.2, 40.0, None)
    assert "up to 4.5 points" in pays.verdict
    even = dataclasses.replace(pays, oracle_percent=90.8)
    assert "0.0 points" in even.verdict and "orbit-high" in even.verdict


def test_an_unknown_mesh_is_said():
    with pytest.raises(UserError, match="no mesh file"):
        ceiling("nowhere/part.stl")
