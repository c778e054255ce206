"""Procedural rocks: what they promise, and that they are the same everywhere and always."""

from __future__ import annotations

import numpy as np
import pytest

from nbv.geometry.raycasting import RayCaster
from nbv.rocks import describe
from nbv.rocks.noise import cells, gradient_noise
from nbv.rocks.procedural import generate_rock, sample_near_surface
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
    assert facts.boundary_edges == 0
    assert facts.volume_m3 is not None and facts.volume_m3 > 0.3  # faces wind outwards
    assert max(facts.extents_m) < 2.2
    # A flat contact: some area lies in the ground plane, but not most of it.
    base = rock.vertices_m[rock.faces][:, :, 2].max(1) < 1e-6
    corners = rock.vertices_m[rock.faces[base]]
    base_area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    assert 0.005 < base_area.sum() / facts.area_m2 < 0.2
    assert rock.albedo.shape == rock.vertices_m.shape and rock.albedo.dtype == np.float32
    assert 0.15 < np.mean(facts.mean_albedo) < 0.55
    assert facts.albedo_contrast > 0.1


def test_split_is_disjoint_and_large_enough():
    splits = [recipe.split for recipe in RECIPES.values()]
    assert splits.count("train") >= 5 and splits.count("held-out") >= 12
    seeds = [recipe.seed for recipe in RECIPES.values()]
    assert len(set(seeds)) == len(seeds)


@pytest.mark.slow
def test_same_seed_same_rock_other_seed_other_rock(rocks):
    assert generate_rock("waist", grid_m=COARSE_M).sha256 == rocks["waist"].sha256
    assert len({rock.sha256 for rock in rocks.values()}) == len(rocks)


@pytest.mark.slow
def test_claimed_overhangs_exist(rocks):
    def cover(rock, low, high):
        """Horizontal area of the rock's shadow that lies under a downward-looking face between two heights."""
        corners = rock.vertices_m[rock.faces]
        cross = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        z = corners[:, :, 2].mean(1)
        return -cross[(cross[:, 2] < 0) & (z > low) & (z < high), 2].sum()

    assert cover(rocks["mushroom"], 0.5, 1.3) > 0.6
    assert cover(rocks["waist"], 0.5, 1.3) > 0.3
    assert cover(rocks["arch"], 0.5, 1.3) > 0.2
    assert cover(rocks["cavern"], 0.3, 1.3) > 0.25
    assert cover(rocks["stack"], 0.3, 1.5) > 1.0
    assert cover(rocks["tripod"], 0.5, 1.3) > 0.5
    assert cover(rocks["prow"], 0.2, 1.4) > 1.0
    assert cover(rocks["horn"], 0.3, 1.5) > 0.2
    assert describe(rocks["mushroom"]).overhang_fraction > describe(rocks["boulder"]).overhang_fraction


def hits(rock, rays):
    """How far along each ray (six numbers: from, direction) the rock is; infinite where it is missed."""
    return RayCaster(rock.vertices_m, rock.faces).cast(np.array(rays, dtype=np.float32)).t


@pytest.mark.slow
def test_arch_has_a_window_and_boulder_has_not(rocks):
    # Level rays through the middle of the rock's lower half, across it.
    rays = [[x, -3.0, 0.4, 0.0, 1.0, 0.0] for x in np.linspace(-0.2, 0.2, 9)]
    assert np.isinf(hits(rocks["arch"], rays)).any()
    assert not np.isinf(hits(rocks["boulder"], rays)).any()


@pytest.mark.slow
def test_claimed_hollows_are_open_where_they_should_be(rocks):
    def height(name, x, y):
        return 4.0 - hits(rocks[name], [[x, y, 4.0, 0.0, 0.0, -1.0]])[0]

    rim = np.median(
        [height("bowl", 0.55 * np.cos(a), 0.55 * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 24)]
    )
    assert height("bowl", 0.05, 0.0) < rim - 0.25
    # Between tripod's legs a ray from the ground up meets the ceiling, not the ground's contact.
    assert 0.3 < hits(rocks["tripod"], [[0.0, 0.0, 0.01, 0.0, 0.0, 1.0]])[0] < 1.2


@pytest.mark.parametrize("name", ["spire", "vesicular", "cleft", "fin", "horn"])
def test_blocks_that_are_skipped_hold_no_surface(name):
    """The narrow band finds the same solid as evaluating the shape at every node."""
    shape = RECIPES[name].shape
    distance, origin = sample_near_surface(shape, 0.03)
    nodes = origin + np.argwhere(np.ones(distance.shape, dtype=bool)) * 0.03
    everywhere = shape(nodes).reshape(distance.shape)
    inner = np.s_[1:-2, 1:-2, 1:-2]
    agree = (everywhere < 1e-6)[inner] == (distance < 1e-6)[inner]
    assert agree.all()


@pytest.mark.slow
def test_full_resolution_is_finer_than_a_pixel():
    facts = describe(generate_rock("arch"))
    assert facts.mean_edge_m < 0.0075  # ground sampling distance at 3.5 m
    assert facts.boundary_edges == 0


def test_gradient_noise_is_standardised_continuous_and_aperiodic():
    rng = np.random.default_rng(0)
    points = rng.uniform(-50, 50, size=(100_000, 3))
    noise = gradient_noise(points, 1.0, seed=3)
    assert abs(noise.mean()) < 0.02
    assert noise.std() == pytest.approx(0.84, abs=0.02)
    assert np.abs(gradient_noise(points + 1e-4, 1.0, 3) - noise).max() < 0.01
    for shift in (2.0, 16.0, 256.0):
        other = gradient_noise(points + np.array([shift, 0, 0]), 1.0, 3)
        assert abs(np.corrcoef(noise, other)[0, 1]) < 0.02
    assert abs(np.corrcoef(noise, gradient_noise(points, 1.0, 4))[0, 1]) < 0.02


def test_cells_are_constant_inside_and_of_the_asked_size():
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 1, size=(40_000, 3))
    label, distance = cells(points, 0.1, seed=1)
    assert 700 < len(np.unique(label)) < 1900  # about a thousand grains in a cubic metre
    assert distance.max() < 1.2
    near, _ = cells(points + 1e-5, 0.1, seed=1)
    assert (near == label).mean() > 0.99
