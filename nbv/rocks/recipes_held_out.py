"""Eight more procedural rocks that nothing was ever tuned on, drawn before any mission flew on them.

Another eight shapes than in `recipes`; how they came about: docs/results/held_out.md.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from nbv.rocks import sdf
from nbv.rocks.albedo import Paint
from nbv.rocks.recipe import Recipe, Shape, facets, grounded, rough, warp
from nbv.types import Floats


def _fused(parts: Sequence[Floats]) -> Floats:
    """The union of all parts, one after the other, with seams of 5 cm."""
    return functools.reduce(lambda whole, part: sdf.union(whole, part, 0.05), parts)


def _cairn(seed: int) -> Shape:
    blocks = (  # centre, half sizes, yaw, pitch, roll
        ((-0.36, -0.24, 0.28), (0.44, 0.36, 0.34), (20, 8, 0)),
        ((0.42, -0.08, 0.26), (0.34, 0.42, 0.30), (-15, -10, 6)),
        ((0.00, 0.42, 0.24), (0.42, 0.28, 0.30), (35, 0, 12)),
        ((-0.14, 0.04, 0.80), (0.44, 0.34, 0.27), (-25, 10, -8)),
        ((0.38, 0.16, 0.72), (0.22, 0.28, 0.24), (40, -16, 0)),
        ((0.04, -0.04, 1.28), (0.27, 0.32, 0.28), (60, 6, 14)),
    )

    def shape(p: Floats) -> Floats:
        q = warp(p, seed, 0.03, 0.6)
        parts = []
        for k, (center, half, angles) in enumerate(blocks):
            block = sdf.box(q, center, half, 0.09, sdf.rotation(*angles))
            hewn = facets(q, seed * 10 + k, 7, center, 1.15 * max(half))
            parts.append(sdf.intersection(block, hewn, 0.03))
        return grounded(p, _fused(parts) + rough(p, seed, 0.8))

    return shape


def _fin(seed: int) -> Shape:
    radius, half_length = 1.15, 0.9

    def shape(p: Floats) -> Floats:
        q = warp(p, seed, 0.05, 0.6)
        # A blade along an arc about (0, -radius), thinner and further back with height.
        along = radius * np.arctan2(q[:, 0], q[:, 1] + radius)
        across = np.hypot(q[:, 0], q[:, 1] + radius) - radius - 0.12 * q[:, 2]
        thickness = 0.25 - 0.09 * q[:, 2]
        crest = 1.5 - 0.55 * (along - 0.15) ** 2 + 0.09 * np.sin(9.0 * along)
        d = sdf.intersection(np.abs(across) - thickness, np.abs(along) - half_length, 0.1)
        d = 0.8 * sdf.intersection(d, q[:, 2] - crest, 0.12)
        return grounded(p, d + rough(p, seed, 0.9))

    return shape


def _bowl(seed: int) -> Shape:
    def shape(p: Floats) -> Floats:
        q = warp(p, seed, 0.05, 0.7)
        d = sdf.ellipsoid(q, (0, 0, 0.5), (0.76, 0.7, 1.1))
        d = sdf.intersection(d, sdf.half_space(q - np.array([0, 0, 1.38]), (0.12, -0.06, 1), 0.0), 0.1)
        hollow = sdf.ellipsoid(q, (0.06, -0.02, 1.4), (0.46, 0.4, 0.72))
        breach = sdf.capsule(q, (0.1, -0.1, 1.45), (0.9, -0.5, 1.2), 0.2)
        d = sdf.subtract(sdf.subtract(d, hollow, 0.06), breach, 0.06)
        return grounded(p, d + rough(p, seed, 0.9))

    return shape


def _terrace(seed: int) -> Shape:
    steps = (  # centre x and y, top, half sizes, yaw
        (0.00, 0.00, 0.34, (0.78, 0.68), 10),
        (-0.08, 0.05, 0.66, (0.66, 0.60), 35),
        (-0.12, -0.02, 0.98, (0.52, 0.42), 5),
        (-0.04, -0.06, 1.30, (0.36, 0.34), 50),
        (-0.08, 0.00, 1.60, (0.20, 0.24), 20),
    )

    def shape(p: Floats) -> Floats:
        q = warp(p, seed, 0.06, 0.7)
        parts = []
        for x, y, top, (a, b), yaw in steps:
            half = 0.5 * (top + 0.3)
            parts.append(sdf.box(q, (x, y, top - half), (a, b, half), 0.07, sdf.rotation(yaw, 3, -2)))
        return grounded(p, _fused(parts) + rough(p, seed, 0.9))

    return shape


def _horn(seed: int) -> Shape:
    center, bend, tip = np.array([0.22, 0.0, 0.62]), 0.62, np.deg2rad(15.0)

    def shape(p: Floats) -> Floats:
        q = warp(p, seed, 0.04, 0.6)
        # A tube that tapers along an arc in the x-z plane, from the ground on the left over the top to the right.
        angle = np.arctan2(q[:, 2] - center[2], q[:, 0] - center[0])
        angle = np.clip(np.where(angle < -np.pi / 2, angle + 2 * np.pi, angle), tip, np.pi)
        axis = np.stack([np.cos(angle), np.zeros(len(q)), np.sin(angle)], axis=1)
        width = 0.12 + 0.28 * (angle - tip) / (np.pi - tip)
        d = 0.85 * (np.linalg.norm(q - center - bend * axis, axis=1) - width)
        foot = sdf.ellipsoid(q, (-0.38, 0.0, 0.1), (0.58, 0.52, 0.6))
        return grounded(p, sdf.union(d, foot, 0.12) + rough(p, seed, 0.9))

    return shape


def _stack(seed: int) -> Shape:
    plates = (  # centre, half sizes, yaw, pitch, roll
        ((0.00, 0.00, 0.12), (0.70, 0.56, 0.20), (0, 0, 0)),
        ((0.08, 0.06, 0.54), (0.66, 0.60, 0.12), (30, 4, -3)),
        ((-0.10, -0.04, 0.90), (0.70, 0.46, 0.11), (-20, -5, 4)),
        ((0.06, 0.02, 1.22), (0.54, 0.52, 0.10), (55, 5, 2)),
        ((-0.04, 0.06, 1.52), (0.46, 0.36, 0.11), (10, -4, -6)),
    )

    def shape(p: Floats) -> Floats:
        q = warp(p, seed, 0.05, 0.7)
        d = sdf.capsule(q, (0.02, 0.0, 0.0), (-0.02, 0.02, 1.4), 0.3)
        for center, half, angles in plates:
            d = sdf.union(d, sdf.box(q, center, half, 0.06, sdf.rotation(*angles)), 0.04)
        return grounded(p, d + rough(p, seed, 0.7))

    return shape


def _tripod(seed: int) -> Shape:
    def shape(p: Floats) -> Floats:
        q = warp(p, seed, 0.05, 0.7)
        d = sdf.ellipsoid(q, (0, 0, 1.14), (0.74, 0.64, 0.48), sdf.rotation(20, 8, -5))
        for degrees, radius in ((15, 0.24), (140, 0.20), (250, 0.27)):
            x, y = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
            leg = sdf.capsule(q, (0.58 * x, 0.54 * y, -0.1), (0.36 * x, 0.32 * y, 0.95), radius)
            d = sdf.union(d, leg, 0.1)
        return grounded(p, d + rough(p, seed))

    return shape


def _prow(seed: int) -> Shape:
    hull = (  # outward normal, offset: a keel on the ground, sides that lean out, a slanted deck
        ((0.0, 1.0, -0.55), 0.17),
        ((0.1, -1.0, -0.45), 0.19),
        ((1.0, 0.15, -0.45), 0.42),
        ((-1.0, 0.1, 0.1), 0.62),
        ((-0.5, 0.7, -0.3), 0.42),
        ((0.7, 0.7, -0.2), 0.5),
        ((-0.22, 0.1, 1.0), 1.4),
    )

    def shape(p: Floats) -> Floats:
        q = warp(p, seed, 0.05, 0.7)
        d = facets(q, seed, 10, (0.1, 0, 0.9), 0.9)
        for normal, offset in hull:
            d = sdf.intersection(d, sdf.half_space(q, normal, offset), 0.07)
        return grounded(p, d + rough(p, seed))

    return shape


MORE_HELD_OUT = (
    Recipe(
        "cairn",
        "held-out",
        21,
        "a pile of fused blocks: re-entrant corners on every side",
        _cairn,
        Paint(grey=0.36, clasts=0.4, dust=0.35),
    ),
    Recipe(
        "fin",
        "held-out",
        22,
        "a curved blade: two faces that no view sees together, a thin crest",
        _fin,
        Paint(grey=0.30, clasts=0.4, dust=0.4),
    ),
    Recipe(
        "bowl",
        "held-out",
        23,
        "a deep bowl in the top, seen from high views only",
        _bowl,
        Paint(grey=0.40, clasts=0.6, dust=0.35),
    ),
    Recipe(
        "terrace",
        "held-out",
        24,
        "a stepped cone: level treads that low views do not see, dusty",
        _terrace,
        Paint(grey=0.32, clasts=0.3, dust=0.5),
    ),
    Recipe(
        "horn",
        "held-out",
        25,
        "a horn that bends over: its inner side and the ground below it are hidden",
        _horn,
        Paint(grey=0.27, clasts=0.35, dust=0.3),
    ),
    Recipe(
        "stack",
        "held-out",
        26,
        "plates one above the other with slots between them",
        _stack,
        Paint(grey=0.35, clasts=0.5, grains=0.6, dust=0.45),
    ),
    Recipe(
        "tripod",
        "held-out",
        27,
        "hard: a chamber between three legs, open to low views only",
        _tripod,
        Paint(grey=0.42, clasts=0.7, dust=0.3),
    ),
    Recipe(
        "prow",
        "held-out",
        28,
        "a hull on a keel: convex, but most of its sides lean out",
        _prow,
        Paint(grey=0.24, clasts=0.2, grains=0.6, dust=0.3),
    ),
)
