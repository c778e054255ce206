"""Procedural rocks: what they promise, and that they are the same everywhere and always."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from nbv.rocks import describe
from nbv.rocks.procedural import generate_rock
from nbv.rocks.recipes import RECIPES

COARSE_M = 0.025


@pytest.fixture(scope="module")
def rocks():
    return {name: generate_rock(name, grid_m=COARSE_M) for name in RECIPES}


@pytest.mark.slow
@pytest.mark.parametrize("name", list(RECIPES))
def test_stands_on_the_ground_and_is_closed(rocks, name):
    rock = rocks[name]
    low, high = rock.vertices_m.min(0), rock.vertices_m.max(0)
    assert low[2] == 0.0
    assert high[2] == pytest.approx(1.6, abs=1e-12)
    assert low[:2] + high[:2] == pytest.approx([0, 0], abs=1e-9)
    facts = describe(rock)
    assert facts["boundary_edges"] == 0
    assert facts["volume_m3"] is not None and facts["volume_m3"] > 0.3  # faces wind outwards
    assert max(facts["extents_m"]) < 2.2
    # A flat contact: some area lies in the ground plane, but not most of it.
    base = rock.vertices_m[rock.faces][:, :, 2].max(1) < 1e-6
    corners = rock.vertices_m[rock.faces[base]]
    base_area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    assert 0.005 < base_area.sum() / facts["area_m2"] < 0.2
    assert rock.albedo.shape == rock.vertices_m.shape and rock.albedo.dtype == np.float32
    assert 0.15 < np.mean(facts["mean_albedo"]) < 0.55
    assert facts["albedo_contrast"] > 0.1


def test_split_is_disjoint_and_large_enough():
    splits = [recipe.split for recipe in RECIPES.values()]
    assert splits.count("train") >= 5 and splits.count("held-out") >= 12
    seeds = [recipe.seed for recipe in RECIPES.values()]
    assert len(set(seeds)) == len(seeds)


@pytest.mark.slow
def test_the_rocks_are_what_all_missions_flew_on(rocks):
    """A changed digest is a changed rock: every number that was measured on it would have to be measured anew."""
    assert len({rock.sha256 for rock in rocks.values()}) == len(rocks)
    digest = hashlib.sha256("".join(rock.sha256 for rock in rocks.values()).encode()).hexdigest()
    assert digest == "99ce682805b7b780208fa8349abfbee7b5d1ab0f53f8fbd01c4bd2be1ad66490"
    assert generate_rock("waist", grid_m=COARSE_M).sha256 == rocks["waist"].sha256
    assert describe(rocks["mushroom"])["overhang_fraction"] > describe(rocks["boulder"])["overhang_fraction"]
