"""Rocks drawn from families: what the stated distribution promises."""

import pytest

from nbv.errors import UserError
from nbv.rocks import describe, load_coarse_rock, load_rock
from nbv.rocks.families import EVERY, generated_name, generated_recipe
from nbv.rocks.procedural import generate_rock

COARSE_M = 0.03


@pytest.mark.parametrize("family", EVERY)
def test_a_drawn_rock_is_closed_and_stands_on_the_ground(family: str) -> None:
    rock = generate_rock(f"{family}-5", grid_m=COARSE_M)
    facts = describe(rock)
    assert facts["boundary_edges"] == 0 and facts["volume_m3"] is not None and facts["volume_m3"] > 0.02
    assert rock.vertices_m[:, 2].min() == pytest.approx(0.0, abs=1e-9)
    assert facts["extents_m"][2] == pytest.approx(generated_recipe(family, 5).height_m)
    assert rock.split == "train"


def test_a_name_is_one_rock() -> None:
    expected = "42a8463c6453da902cbd3c2ef7bf324b45370e7c6959e83e3cc9abf226f61905"
    assert load_coarse_rock("cleft-3").sha256 == expected  # on every machine


def test_splits_are_ranges_of_seeds() -> None:
    splits = [generated_recipe("slab", seed).split for seed in (0, 9_999, 10_000, 19_999, 20_000)]
    assert splits == ["train", "train", "validation", "validation", "held-out"]


def test_what_is_no_generated_rock_is_said() -> None:
    assert generated_name("boulder") is None and generated_name("pebble-3") is None
    with pytest.raises(UserError, match=r"no family 'pebble' of rocks; choose from boulder"):
        generated_recipe("pebble", 3)
    with pytest.raises(UserError, match=r"seed -1 .* not from 0"):
        generated_recipe("slab", -1)
    with pytest.raises(UserError, match=r"seed 99999999 .* not from 0"):
        load_rock("slab-99999999")
