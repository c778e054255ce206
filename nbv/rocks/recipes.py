"""The procedural rocks: what each is shaped like, painted like, and hard for.

Shapes are drawn at about 1.6 m height and cut flat at z = 0: a rock lies a few centimetres deep in the
regolith, so its base is a flat contact and not a point.
"""

from __future__ import annotations

import numpy as np

from nbv.rocks import sdf
from nbv.rocks.albedo import Paint
from nbv.rocks.recipe import Recipe, Shape, facets, grounded, rough, warp
from nbv.rocks.recipes_held_out import MORE_HELD_OUT
from nbv.types import Floats


def _boulder(seed: int) -> Shape:
    def shape(p: Floats) -> Floats:
        q = warp(p, seed, 0.03, 0.9)
        d = sdf.box(q, (0, 0, 0.74), (0.66, 0.58, 0.84), 0.24, sdf.rotation(25, 8, -6))
        d = sdf.intersection(d, facets(q, seed, 9, (0, 0, 0.75), 0.78), 0.06)
        return grounded(p, d + rough(p, seed))

    return shape


def _slab(seed: int) -> Shape:
    def shape(p: Floats) -> Floats:
        q = warp(p, seed, 0.03, 0.7)
        d = sdf.box(q, (0.05, 0, 0.66), (0.27, 0.62, 0.93), 0.1, sdf.rotation(20, 24, 0))
        toe = sdf.ellipsoid(q, (-0.3, 0.08, 0.0), (0.42, 0.5, 0.3))
        return grounded(p, sdf.union(d, toe, 0.12) + rough(p, seed, 0.8))

    return shape


def _vesicular(seed: int) -> Shape:
    def body(p: Floats) -> Floats:
        q = warp(p, seed, 0.05, 0.8)
        d = sdf.ellipsoid(q, (0, 0, 0.66), (0.72, 0.6, 0.96), sdf.rotation(40, 10, 0))
        return d + rough(p, seed, 0.9)

    rng = np.random.default_rng(seed)
    places = rng.uniform((-0.9, -0.9, 0.0), (0.9, 0.9, 1.7), size=(30_000, 3))
    radii = np.minimum(0.018 * (1.0 - rng.uniform(size=len(places))) ** -0.45, 0.11)
    near = np.abs(body(places)) < 0.5 * radii  # bubbles that break the surface
    places, radii = places[near][:900], radii[near][:900]

    def shape(p: Floats) -> Floats:
        return grounded(p, sdf.subtract(body(p), sdf.spheres(p, places, radii), 0.008))

    return shape


def _waist(seed: int) -> Shape:
    def shape(p: Floats) -> Floats:
        q = warp(p, seed, 0.04, 0.7)
        low = sdf.ellipsoid(q, (0, 0, 0.22), (0.66, 0.58, 0.42))
        high = sdf.ellipsoid(q, (0.1, -0.05, 1.2), (0.64, 0.52, 0.42), sdf.rotation(30, 12, 0))
        neck = sdf.capsule(q, (0, 0, 0.3), (0.06, 0, 1.1), 0.3)
        d = sdf.union(sdf.union(low, neck, 0.12), high, 0.12)
        return grounded(p, d + rough(p, seed))

    return shape


def _breccia(seed: int) -> Shape:
    def shape(p: Floats) -> Floats:
        q = warp(p, seed, 0.06, 0.6)
        big = sdf.ellipsoid(q, (-0.3, 0, 0.68), (0.5, 0.58, 0.92), sdf.rotation(10, -10, 0))
        small = sdf.ellipsoid(q, (0.46, 0.12, 0.36), (0.5, 0.42, 0.56), sdf.rotation(-20, 20, 0))
        small = sdf.intersection(small, facets(q, seed + 1, 8, (0.46, 0.12, 0.36), 0.4), 0.04)
        d = sdf.union(big, small, 0.05)
        d = sdf.intersection(d, facets(q, seed, 14, (0, 0, 0.7), 0.92), 0.03)
        return grounded(p, d + rough(p, seed, 1.15))

    return shape


def _cavern(seed: int) -> Shape:
    def shape(p: Floats) -> Floats:
        q = warp(p, seed, 0.05, 0.7)
        d = sdf.ellipsoid(q, (0, 0, 0.6), (0.74, 0.7, 1.0))
        cave = sdf.ellipsoid(q, (0.62, -0.1, 0.42), (0.55, 0.42, 0.34), sdf.rotation(-8, 10, 0))
        niche = sdf.ellipsoid(q, (-0.42, 0.55, 0.72), (0.3, 0.34, 0.26))
        d = sdf.subtract(sdf.subtract(d, cave, 0.05), niche, 0.04)
        return grounded(p, d + rough(p, seed))

    return shape


def _arch(seed: int) -> Shape:
    def shape(p: Floats) -> Floats:
        q = warp(p, seed, 0.05, 0.7)
        left = sdf.capsule(q, (-0.55, 0.05, 0.0), (-0.42, 0, 0.95), 0.3)
        right = sdf.capsule(q, (0.58, -0.05, 0.0), (0.4, 0, 0.9), 0.25)
        top = sdf.ellipsoid(q, (-0.02, 0, 1.2), (0.72, 0.36, 0.36), sdf.rotation(0, -6, 0))
        d = sdf.union(sdf.union(left, right, 0.1), top, 0.16)
        return grounded(p, d + rough(p, seed, 0.9))

    return shape


def _spire(seed: int) -> Shape:
    def shape(p: Floats) -> Floats:
        angle = 1.1 * p[:, 2]
        c, s = np.cos(angle), np.sin(angle)
        q = np.stack([c * p[:, 0] + s * p[:, 1], -s * p[:, 0] + c * p[:, 1], p[:, 2]], axis=1)
        q = warp(q, seed, 0.03, 0.5)
        taper = 0.56 - 0.26 * np.clip(q[:, 2] / 1.6, 0, 1)
        ledges = 0.05 * np.sin(q[:, 2] * 15.0)
        d = 0.7 * (np.maximum(np.abs(q[:, 0]) / 1.15, np.abs(q[:, 1])) - taper - ledges)
        d = sdf.intersection(d, q[:, 2] - 1.6, 0.2)
        shoulder = sdf.ellipsoid(p, (0.42, 0.3, 0.2), (0.34, 0.4, 0.46))
        return grounded(p, sdf.union(d, shoulder, 0.06) + rough(p, seed, 0.9))

    return shape


def _mushroom(seed: int) -> Shape:
    def shape(p: Floats) -> Floats:
        q = warp(p, seed, 0.05, 0.8)
        stem = sdf.capsule(q, (-0.05, 0, -0.2), (0.0, 0, 1.0), 0.36)
        foot = sdf.ellipsoid(q, (0, 0, 0.0), (0.56, 0.5, 0.22))
        cap = sdf.ellipsoid(q, (0.06, 0.02, 1.18), (0.86, 0.74, 0.42), sdf.rotation(15, 6, 0))
        d = sdf.union(sdf.union(stem, foot, 0.15), cap, 0.08)
        return grounded(p, d + rough(p, seed))

    return shape


def _cleft(seed: int) -> Shape:
    def shape(p: Floats) -> Floats:
        q = warp(p, seed, 0.05, 0.7)
        d = sdf.box(q, (0, 0, 0.72), (0.72, 0.62, 0.86), 0.3, sdf.rotation(10, -5, 4))
        d = sdf.intersection(d, facets(q, seed, 8, (0, 0, 0.75), 0.82), 0.05)
        crack = sdf.box(q, (0.08, 0.1, 1.3), (0.09, 1.2, 0.5), 0.05, sdf.rotation(24, 9, 0))
        side = sdf.box(q, (0.5, -0.3, 0.5), (0.6, 0.07, 0.34), 0.04, sdf.rotation(-30, 0, 25))
        d = sdf.subtract(sdf.subtract(d, crack, 0.04), side, 0.03)
        return grounded(p, d + rough(p, seed, 0.9))

    return shape


_RECIPES = (
    Recipe("boulder", "train", 11, "easy: blocky, nearly convex, well textured", _boulder),
    Recipe(
        "slab", "train", 12, "leaning slab: an underside on one side, narrow edges", _slab, Paint(dust=0.45)
    ),
    Recipe(
        "vesicular",
        "train",
        13,
        "hundreds of bubbles 2 to 11 cm deep, fine even grain",
        _vesicular,
        Paint(grey=0.26, clasts=0.15, dust=0.25),
    ),
    Recipe("waist", "train", 14, "narrow waist under an overhanging head", _waist),
    Recipe(
        "breccia",
        "train",
        15,
        "two lobes with a deep gap, strong clasts",
        _breccia,
        Paint(grey=0.42, clasts=0.9, dust=0.2),
    ),
    Recipe(
        "cavern",
        "train",
        16,
        "two caves in the lower half, seen from few low views",
        _cavern,
        Paint(grey=0.30, dust=0.4),
    ),
    Recipe("arch", "held-out", 17, "a window through the rock, inner faces seen from below only", _arch),
    Recipe(
        "spire",
        "held-out",
        18,
        "twisted column with ledges and little surface to match",
        _spire,
        Paint(grey=0.28, clasts=0.3, dust=0.3),
    ),
    Recipe(
        "mushroom",
        "held-out",
        19,
        "hard: a wide cap hides stem and underside from most views",
        _mushroom,
        Paint(grey=0.38, clasts=0.5, dust=0.45),
    ),
    Recipe(
        "cleft",
        "held-out",
        20,
        "two deep, narrow cracks and faces with weak texture",
        _cleft,
        Paint(dust=0.55),
    ),
)

RECIPES: dict[str, Recipe] = {recipe.name: recipe for recipe in (*_RECIPES, *MORE_HELD_OUT)}
