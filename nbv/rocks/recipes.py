"""The procedural rocks: what each is shaped like, painted like, and hard for (the docstring of its function).

Shapes are drawn at about 1.6 m height and cut flat at z = 0: a rock lies a few centimetres deep in the
regolith, so its base is a flat contact and not a point.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from nbv.rocks import sdf
from nbv.rocks.rock import Split
from nbv.rocks.sdf import Recipe, facets, grounded, rough, warp
from nbv.rocks.texture import Paint
from nbv.types import Floats

RECIPES: dict[str, Recipe] = {}
Body = Callable[[Floats, int], Floats]  # (N, 3) points in metres and the rock's seed -> (N,) signed distance


def recipe(
    split: Split,
    seed: int,
    paint: Paint = Paint(),  # noqa: B008  frozen
    *,
    bend: tuple[float, float] | None = None,
    relief: float = 1.0,
) -> Callable[[Body], Body]:
    """Enter a rock in `RECIPES` under the name of its function, which draws the bare body.

    ``bend`` is amplitude and wavelength (m) of the random field by which the body is bent; ``relief`` how rough the surface is, as a
    share of `rough`, with 0 for a body that has relief of its own.
    """

    def enter(body: Body) -> Body:
        def shape(p: Floats) -> Floats:
            d = body(warp(p, seed, *bend) if bend else p, seed)
            return grounded(p, d + rough(p, seed, relief) if relief else d)

        RECIPES[body.__name__] = Recipe(split, seed, body.__doc__ or "", shape, paint)
        return body

    return enter


@recipe("train", 11, bend=(0.03, 0.9))
def boulder(q: Floats, seed: int) -> Floats:
    """easy: blocky, nearly convex, well textured"""
    d = sdf.box(q, (0, 0, 0.74), (0.66, 0.58, 0.84), 0.24, sdf.rotation(25, 8, -6))
    return sdf.intersection(d, facets(q, seed, 9, (0, 0, 0.75), 0.78), 0.06)


@recipe("train", 12, Paint(dust=0.45), bend=(0.03, 0.7), relief=0.8)
def slab(q: Floats, seed: int) -> Floats:
    """leaning slab: an underside on one side, narrow edges"""
    d = sdf.box(q, (0.05, 0, 0.66), (0.27, 0.62, 0.93), 0.1, sdf.rotation(20, 24, 0))
    toe = sdf.ellipsoid(q, (-0.3, 0.08, 0.0), (0.42, 0.5, 0.3))
    return sdf.union(d, toe, 0.12)


@recipe("train", 13, Paint(grey=0.26, clasts=0.15, dust=0.25), relief=0.0)
def vesicular(p: Floats, seed: int) -> Floats:
    """hundreds of bubbles 2 to 11 cm deep, fine even grain"""
    return sdf.subtract(_before_bubbles(p, seed), sdf.spheres(p, *_bubbles(seed)), 0.008)


def _before_bubbles(p: Floats, seed: int) -> Floats:
    q = warp(p, seed, 0.05, 0.8)
    d = sdf.ellipsoid(q, (0, 0, 0.66), (0.72, 0.6, 0.96), sdf.rotation(40, 10, 0))
    return d + rough(p, seed, 0.9)


@lru_cache(maxsize=1)
def _bubbles(seed: int) -> tuple[Floats, Floats]:
    """Centres (M, 3) and radii (M,) of the bubbles that break the surface, in metres."""
    rng = np.random.default_rng(seed)
    places = rng.uniform((-0.9, -0.9, 0.0), (0.9, 0.9, 1.7), size=(30_000, 3))
    radii = np.minimum(0.018 * (1.0 - rng.uniform(size=len(places))) ** -0.45, 0.11)
    near = np.abs(_before_bubbles(places, seed)) < 0.5 * radii
    return places[near][:900], radii[near][:900]


@recipe("train", 14, bend=(0.04, 0.7))
def waist(q: Floats, seed: int) -> Floats:
    """narrow waist under an overhanging head"""
    low = sdf.ellipsoid(q, (0, 0, 0.22), (0.66, 0.58, 0.42))
    high = sdf.ellipsoid(q, (0.1, -0.05, 1.2), (0.64, 0.52, 0.42), sdf.rotation(30, 12, 0))
    neck = sdf.capsule(q, (0, 0, 0.3), (0.06, 0, 1.1), 0.3)
    return sdf.union(sdf.union(low, neck, 0.12), high, 0.12)


@recipe("train", 15, Paint(grey=0.42, clasts=0.9, dust=0.2), bend=(0.06, 0.6), relief=1.15)
def breccia(q: Floats, seed: int) -> Floats:
    """two lobes with a deep gap, strong clasts"""
    big = sdf.ellipsoid(q, (-0.3, 0, 0.68), (0.5, 0.58, 0.92), sdf.rotation(10, -10, 0))
    small = sdf.ellipsoid(q, (0.46, 0.12, 0.36), (0.5, 0.42, 0.56), sdf.rotation(-20, 20, 0))
    small = sdf.intersection(small, facets(q, seed + 1, 8, (0.46, 0.12, 0.36), 0.4), 0.04)
    d = sdf.union(big, small, 0.05)
    return sdf.intersection(d, facets(q, seed, 14, (0, 0, 0.7), 0.92), 0.03)


@recipe("train", 16, Paint(grey=0.3, dust=0.4), bend=(0.05, 0.7))
def cavern(q: Floats, seed: int) -> Floats:
    """two caves in the lower half, seen from few low views"""
    d = sdf.ellipsoid(q, (0, 0, 0.6), (0.74, 0.7, 1.0))
    cave = sdf.ellipsoid(q, (0.62, -0.1, 0.42), (0.55, 0.42, 0.34), sdf.rotation(-8, 10, 0))
    niche = sdf.ellipsoid(q, (-0.42, 0.55, 0.72), (0.3, 0.34, 0.26))
    return sdf.subtract(sdf.subtract(d, cave, 0.05), niche, 0.04)


@recipe("held-out", 17, bend=(0.05, 0.7), relief=0.9)
def arch(q: Floats, seed: int) -> Floats:
    """a window through the rock, inner faces seen from below only"""
    left = sdf.capsule(q, (-0.55, 0.05, 0.0), (-0.42, 0, 0.95), 0.3)
    right = sdf.capsule(q, (0.58, -0.05, 0.0), (0.4, 0, 0.9), 0.25)
    top = sdf.ellipsoid(q, (-0.02, 0, 1.2), (0.72, 0.36, 0.36), sdf.rotation(0, -6, 0))
    return sdf.union(sdf.union(left, right, 0.1), top, 0.16)


@recipe("held-out", 18, Paint(grey=0.28, clasts=0.3, dust=0.3), relief=0.9)
def spire(p: Floats, seed: int) -> Floats:
    """twisted column with ledges and little surface to match"""
    angle = 1.1 * p[:, 2]
    c, s = np.cos(angle), np.sin(angle)
    q = np.stack([c * p[:, 0] + s * p[:, 1], -s * p[:, 0] + c * p[:, 1], p[:, 2]], axis=1)
    q = warp(q, seed, 0.03, 0.5)
    taper = 0.56 - 0.26 * np.clip(q[:, 2] / 1.6, 0, 1)
    ledges = 0.05 * np.sin(q[:, 2] * 15.0)
    d = 0.7 * (np.maximum(np.abs(q[:, 0]) / 1.15, np.abs(q[:, 1])) - taper - ledges)
    d = sdf.intersection(d, q[:, 2] - 1.6, 0.2)
    shoulder = sdf.ellipsoid(p, (0.42, 0.3, 0.2), (0.34, 0.4, 0.46))
    return sdf.union(d, shoulder, 0.06)


@recipe("held-out", 19, Paint(grey=0.38, clasts=0.5, dust=0.45), bend=(0.05, 0.8))
def mushroom(q: Floats, seed: int) -> Floats:
    """hard: a wide cap hides stem and underside from most views"""
    stem = sdf.capsule(q, (-0.05, 0, -0.2), (0.0, 0, 1.0), 0.36)
    foot = sdf.ellipsoid(q, (0, 0, 0.0), (0.56, 0.5, 0.22))
    cap = sdf.ellipsoid(q, (0.06, 0.02, 1.18), (0.86, 0.74, 0.42), sdf.rotation(15, 6, 0))
    return sdf.union(sdf.union(stem, foot, 0.15), cap, 0.08)


@recipe("held-out", 20, Paint(dust=0.55), bend=(0.05, 0.7), relief=0.9)
def cleft(q: Floats, seed: int) -> Floats:
    """two deep, narrow cracks and faces with weak texture"""
    d = sdf.box(q, (0, 0, 0.72), (0.72, 0.62, 0.86), 0.3, sdf.rotation(10, -5, 4))
    d = sdf.intersection(d, facets(q, seed, 8, (0, 0, 0.75), 0.82), 0.05)
    crack = sdf.box(q, (0.08, 0.1, 1.3), (0.09, 1.2, 0.5), 0.05, sdf.rotation(24, 9, 0))
    side = sdf.box(q, (0.5, -0.3, 0.5), (0.6, 0.07, 0.34), 0.04, sdf.rotation(-30, 0, 25))
    return sdf.subtract(sdf.subtract(d, crack, 0.04), side, 0.03)


# The rest nothing was ever tuned on; they were drawn before any mission flew on them (docs/results/index.md).


@recipe("held-out", 21, Paint(grey=0.36, clasts=0.4, dust=0.35), bend=(0.03, 0.6), relief=0.8)
def cairn(q: Floats, seed: int) -> Floats:
    """a pile of fused blocks: re-entrant corners on every side"""
    blocks = (  # centre, half sizes, yaw, pitch, roll
        ((-0.36, -0.24, 0.28), (0.44, 0.36, 0.34), (20, 8, 0)),
        ((0.42, -0.08, 0.26), (0.34, 0.42, 0.30), (-15, -10, 6)),
        ((0.00, 0.42, 0.24), (0.42, 0.28, 0.30), (35, 0, 12)),
        ((-0.14, 0.04, 0.80), (0.44, 0.34, 0.27), (-25, 10, -8)),
        ((0.38, 0.16, 0.72), (0.22, 0.28, 0.24), (40, -16, 0)),
        ((0.04, -0.04, 1.28), (0.27, 0.32, 0.28), (60, 6, 14)),
    )
    parts = []
    for k, (center, half, angles) in enumerate(blocks):
        block = sdf.box(q, center, half, 0.09, sdf.rotation(*angles))
        hewn = facets(q, seed * 10 + k, 7, center, 1.15 * max(half))
        parts.append(sdf.intersection(block, hewn, 0.03))
    return sdf.union_of(parts)


@recipe("held-out", 22, Paint(grey=0.3, clasts=0.4, dust=0.4), bend=(0.05, 0.6), relief=0.9)
def fin(q: Floats, seed: int) -> Floats:
    """a curved blade: two faces that no view sees together, a thin crest"""
    radius, half_length = 1.15, 0.9
    # A blade along an arc about (0, -radius), thinner and further back with height.
    along = radius * np.arctan2(q[:, 0], q[:, 1] + radius)
    across = np.hypot(q[:, 0], q[:, 1] + radius) - radius - 0.12 * q[:, 2]
    thickness = 0.25 - 0.09 * q[:, 2]
    crest = 1.5 - 0.55 * (along - 0.15) ** 2 + 0.09 * np.sin(9.0 * along)
    d = sdf.intersection(np.abs(across) - thickness, np.abs(along) - half_length, 0.1)
    return 0.8 * sdf.intersection(d, q[:, 2] - crest, 0.12)


@recipe("held-out", 23, Paint(grey=0.4, clasts=0.6, dust=0.35), bend=(0.05, 0.7), relief=0.9)
def bowl(q: Floats, seed: int) -> Floats:
    """a deep bowl in the top, seen from high views only"""
    d = sdf.ellipsoid(q, (0, 0, 0.5), (0.76, 0.7, 1.1))
    d = sdf.intersection(d, sdf.half_space(q - np.array([0, 0, 1.38]), (0.12, -0.06, 1), 0.0), 0.1)
    hollow = sdf.ellipsoid(q, (0.06, -0.02, 1.4), (0.46, 0.4, 0.72))
    breach = sdf.capsule(q, (0.1, -0.1, 1.45), (0.9, -0.5, 1.2), 0.2)
    return sdf.subtract(sdf.subtract(d, hollow, 0.06), breach, 0.06)


@recipe("held-out", 24, Paint(grey=0.32, clasts=0.3, dust=0.5), bend=(0.06, 0.7), relief=0.9)
def terrace(q: Floats, seed: int) -> Floats:
    """a stepped cone: level treads that low views do not see, dusty"""
    steps = (  # centre x and y, top, half sizes, yaw
        (0.00, 0.00, 0.34, (0.78, 0.68), 10),
        (-0.08, 0.05, 0.66, (0.66, 0.60), 35),
        (-0.12, -0.02, 0.98, (0.52, 0.42), 5),
        (-0.04, -0.06, 1.30, (0.36, 0.34), 50),
        (-0.08, 0.00, 1.60, (0.20, 0.24), 20),
    )
    parts = []
    for x, y, top, (a, b), yaw in steps:
        half = 0.5 * (top + 0.3)
        parts.append(sdf.box(q, (x, y, top - half), (a, b, half), 0.07, sdf.rotation(yaw, 3, -2)))
    return sdf.union_of(parts)


@recipe("held-out", 25, Paint(grey=0.27, clasts=0.35, dust=0.3), bend=(0.04, 0.6), relief=0.9)
def horn(q: Floats, seed: int) -> Floats:
    """a horn that bends over: its inner side and the ground below it are hidden"""
    center, bend, tip = np.array([0.22, 0.0, 0.62]), 0.62, np.deg2rad(15.0)
    # A tube that tapers along an arc in the x-z plane, from the ground on the left over the top to the right.
    angle = np.arctan2(q[:, 2] - center[2], q[:, 0] - center[0])
    angle = np.clip(np.where(angle < -np.pi / 2, angle + 2 * np.pi, angle), tip, np.pi)
    axis = np.stack([np.cos(angle), np.zeros(len(q)), np.sin(angle)], axis=1)
    width = 0.12 + 0.28 * (angle - tip) / (np.pi - tip)
    d = 0.85 * (np.linalg.norm(q - center - bend * axis, axis=1) - width)
    foot = sdf.ellipsoid(q, (-0.38, 0.0, 0.1), (0.58, 0.52, 0.6))
    return sdf.union(d, foot, 0.12)


@recipe("held-out", 26, Paint(grey=0.35, clasts=0.5, grains=0.6, dust=0.45), bend=(0.05, 0.7), relief=0.7)
def stack(q: Floats, seed: int) -> Floats:
    """plates one above the other with slots between them"""
    plates = (  # centre, half sizes, yaw, pitch, roll
        ((0.00, 0.00, 0.12), (0.70, 0.56, 0.20), (0, 0, 0)),
        ((0.08, 0.06, 0.54), (0.66, 0.60, 0.12), (30, 4, -3)),
        ((-0.10, -0.04, 0.90), (0.70, 0.46, 0.11), (-20, -5, 4)),
        ((0.06, 0.02, 1.22), (0.54, 0.52, 0.10), (55, 5, 2)),
        ((-0.04, 0.06, 1.52), (0.46, 0.36, 0.11), (10, -4, -6)),
    )
    d = sdf.capsule(q, (0.02, 0.0, 0.0), (-0.02, 0.02, 1.4), 0.3)
    for center, half, angles in plates:
        d = sdf.union(d, sdf.box(q, center, half, 0.06, sdf.rotation(*angles)), 0.04)
    return d


@recipe("held-out", 27, Paint(grey=0.42, clasts=0.7, dust=0.3), bend=(0.05, 0.7))
def tripod(q: Floats, seed: int) -> Floats:
    """hard: a chamber between three legs, open to low views only"""
    d = sdf.ellipsoid(q, (0, 0, 1.14), (0.74, 0.64, 0.48), sdf.rotation(20, 8, -5))
    for degrees, radius in ((15, 0.24), (140, 0.20), (250, 0.27)):
        x, y = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
        leg = sdf.capsule(q, (0.58 * x, 0.54 * y, -0.1), (0.36 * x, 0.32 * y, 0.95), radius)
        d = sdf.union(d, leg, 0.1)
    return d


@recipe("held-out", 28, Paint(grey=0.24, clasts=0.2, grains=0.6, dust=0.3), bend=(0.05, 0.7))
def prow(q: Floats, seed: int) -> Floats:
    """a hull on a keel: convex, but most of its sides lean out"""
    hull = (  # outward normal, offset: a keel on the ground, sides that lean out, a slanted deck
        ((0.0, 1.0, -0.55), 0.17),
        ((0.1, -1.0, -0.45), 0.19),
        ((1.0, 0.15, -0.45), 0.42),
        ((-1.0, 0.1, 0.1), 0.62),
        ((-0.5, 0.7, -0.3), 0.42),
        ((0.7, 0.7, -0.2), 0.5),
        ((-0.22, 0.1, 1.0), 1.4),
    )
    d = facets(q, seed, 10, (0.1, 0, 0.9), 0.9)
    for normal, offset in hull:
        d = sdf.intersection(d, sdf.half_space(q, normal, offset), 0.07)
    return d
