"""Procedural rocks: what they promise, and that they are the same everywhere and always."""

import hashlib

import numpy as np
import pytest

from nbv.rocks import describe
from nbv.rocks.procedural import generate_rock
from nbv.rocks.recipes import RECIPES

COARSE_M = 0.025


def test_split_is_disjoint_and_large_enough():
    splits = [recipe.split for recipe in RECIPES.values()]
    assert splits.count("train") >= 5 and splits.count("held-out") >= 12
    seeds = [recipe.seed for recipe in RECIPES.values()]
    assert len(set(seeds)) == len(seeds)


@pytest.mark.slow
def test_the_rocks_are_what_all_missions_flew_on():
    """A changed digest is a changed rock: every number that was measured on it would have to be measured anew."""
    rocks = {name: generate_rock(name, grid_m=COARSE_M) for name in RECIPES}
    assert len({rock.sha256 for rock in rocks.values()}) == len(rocks)
    digest = hashlib.sha256("".join(rock.sha256 for rock in rocks.values()).encode()).hexdigest()
    assert digest == "99ce682805b7b780208fa8349abfbee7b5d1ab0f53f8fbd01c4bd2be1ad66490"
    assert generate_rock("waist", grid_m=COARSE_M).sha256 == rocks["waist"].sha256
    facts = describe(rocks["mushroom"])
    assert facts["overhang_fraction"] > describe(rocks["boulder"])["overhang_fraction"]
    assert facts["boundary_edges"] == 0 and facts["albedo_contrast"] > 0.1
    assert 0.15 < np.mean(facts["mean_albedo"]) < 0.55
