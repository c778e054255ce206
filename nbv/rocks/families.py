"""Rocks by the hundred: families, from each of which a seed draws one rock; ten more of shapes that are no boulders.

A rock is named ``FAMILY-SEED``, such as ``overhang-17``, and made from that name alone. Of every rock are drawn

- height: log-uniform from 0.8 to 3 m, of shapes that are no boulders to 2 m;
- burial: uniform, up to a quarter of the height lies below the ground;
- tilt: uniform, up to 15 degrees, in any direction;
- texture: uniform from poor (little contrast, most of it under dust) to rich (clasts and grains on bare rock);
- relief: uniform from 0.6 to 1.3 of the catalogue's, a quarter of that on shapes that are no boulders;

and the family's own proportions. Seeds below 10,000 are for training, below 20,000 for validation, the others are held out.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from nbv.errors import UserError
from nbv.plugins import Registry
from nbv.rocks import sdf
from nbv.rocks.rock import DEFAULT_HEIGHT_M, Split
from nbv.rocks.sdf import Recipe, facets, grounded, rough, warp
from nbv.rocks.texture import Paint
from nbv.types import Floats

HEIGHT_M, HIGHEST_SHAPE_M = (0.8, 3.0), 2.0
MOST_BURIED, MOST_TILTED_DEG = 0.25, 15.0
VALIDATION_FROM, HELD_OUT_FROM, SEED_LIMIT = 10_000, 20_000, 1_000_000
_NAME = re.compile(r"([a-z]+(?:-[a-z]+)*)-(\d{1,9})")


def _boulder(p: Floats, rng: np.random.Generator, seed: int) -> Floats:
    half = (rng.uniform(0.45, 0.75), rng.uniform(0.4, 0.65), rng.uniform(0.7, 0.85))
    turn, edge, planes = rng.uniform(0, 180), rng.uniform(0.12, 0.35), int(rng.integers(6, 15))
    reach = rng.uniform(0.75, 0.95)
    body = sdf.box(p, (0, 0, 0.75), half, edge, sdf.rotation(turn))
    return sdf.intersection(body, facets(p, seed, planes, (0, 0, 0.75), reach), 0.06)


def _slab(p: Floats, rng: np.random.Generator, seed: int) -> Floats:
    half = (rng.uniform(0.16, 0.32), rng.uniform(0.5, 0.8), rng.uniform(0.7, 0.9))
    turn, lean = rng.uniform(0, 180), rng.uniform(5, 35)
    body = sdf.box(p, (0, 0, 0.65), half, 0.09, sdf.rotation(turn, lean))
    foot = sdf.ellipsoid(p, (-0.2, 0.05, 0.0), (0.45, 0.45, 0.25))
    return sdf.union(body, foot, 0.12)


def _overhang(p: Floats, rng: np.random.Generator, seed: int) -> Floats:
    neck, foot, cap = rng.uniform(0.25, 0.45), rng.uniform(0.4, 0.65), rng.uniform(0.55, 0.85)
    thick, off = rng.uniform(0.3, 0.5), rng.uniform(-0.2, 0.2, size=2)
    turn, nod = rng.uniform(0, 180), rng.uniform(-14, 14)
    low = sdf.ellipsoid(p, (0, 0, 0.1), (foot, 0.9 * foot, 0.35))
    stem = sdf.capsule(p, (0, 0, 0.0), (off[0] / 2, off[1] / 2, 1.1), neck)
    high = sdf.ellipsoid(p, (off[0], off[1], 1.2), (cap, 0.8 * cap, thick), sdf.rotation(turn, nod))
    return sdf.union(sdf.union(low, stem, 0.12), high, 0.1)


def _cleft(p: Floats, rng: np.random.Generator, seed: int) -> Floats:
    d = _boulder(p, rng, seed)
    for _ in range(int(rng.integers(1, 4))):
        center = (rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.3), rng.uniform(0.7, 1.3))
        half = (rng.uniform(0.04, 0.1), 1.2, rng.uniform(0.35, 0.7))
        turn = sdf.rotation(rng.uniform(0, 180), rng.uniform(-15, 15), rng.uniform(-20, 20))
        d = sdf.subtract(d, sdf.box(p, center, half, 0.03, turn), 0.03)
    return d


def _stack(p: Floats, rng: np.random.Generator, seed: int) -> Floats:
    blocks: list[Floats] = []
    height, wide = 0.0, rng.uniform(0.55, 0.75)
    while height < 1.45:
        half_height = rng.uniform(0.17, 0.34)
        at = (rng.uniform(-0.12, 0.12), rng.uniform(-0.12, 0.12), height + half_height)
        half = (wide, wide * rng.uniform(0.7, 1.0), half_height + 0.05)
        turn = sdf.rotation(rng.uniform(0, 180), *rng.uniform(-8, 8, size=2))
        blocks.append(sdf.box(p, at, half, 0.08, turn))
        height += 2 * half_height
        wide = max(0.22, wide * rng.uniform(0.65, 1.05))
    return sdf.union_of(blocks)


def _breccia(p: Floats, rng: np.random.Generator, seed: int) -> Floats:
    lobes = []
    for k in range(int(rng.integers(2, 5))):
        bearing = rng.uniform(0, 2 * np.pi)
        out = 0.0 if k == 0 else rng.uniform(0.25, 0.5)
        high = rng.uniform(0.7, 0.9) if k == 0 else rng.uniform(0.35, 0.65)
        at = (out * np.cos(bearing), out * np.sin(bearing), 0.7 * high)
        size = (rng.uniform(0.35, 0.55), rng.uniform(0.35, 0.55), high)
        turn = sdf.rotation(rng.uniform(0, 180), *rng.uniform(-20, 20, size=2))
        lobes.append(sdf.ellipsoid(p, at, size, turn))
    planes = int(rng.integers(10, 18))
    return sdf.intersection(sdf.union_of(lobes), facets(p, seed, planes, (0, 0, 0.7), 0.95), 0.03)


def _mesa(p: Floats, rng: np.random.Generator, seed: int) -> Floats:
    """A block with sharp edges and a level top, or a wide plate on a narrower foot."""
    wide, deep, edge = rng.uniform(0.35, 0.85), rng.uniform(0.35, 0.85), rng.uniform(0.01, 0.05)
    turn, waist = sdf.rotation(rng.uniform(0, 180)), rng.uniform(0.4, 1.2)
    thick = rng.uniform(0.1, 0.4)
    foot = sdf.box(p, (0, 0, 0.7), (wide * waist, deep * waist, 0.9), edge, turn)
    return sdf.union(foot, sdf.box(p, (0, 0, 1.6 - thick), (wide, deep, thick), edge, turn), 0.02)


def _limbs(p: Floats, rng: np.random.Generator, seed: int) -> Floats:
    """A trunk, standing or on legs, with arms that reach out and up."""
    trunk = rng.uniform(0.16, 0.4)
    parts = [sdf.capsule(p, (0, 0, rng.uniform(0.1, 0.7)), (*rng.uniform(-0.2, 0.2, 2), 1.25), trunk)]
    for low in (*[True] * int(rng.integers(3, 5)), *[False] * int(rng.integers(1, 5))):
        bearing, out = rng.uniform(0, 2 * np.pi), rng.uniform(0.35, 0.8)
        end = (out * np.cos(bearing), out * np.sin(bearing), 0.0 if low else rng.uniform(0.7, 1.5))
        parts.append(sdf.capsule(p, (0, 0, rng.uniform(0.6, 1.1)), end, rng.uniform(0.07, 0.17)))
    return sdf.union_of(parts)


def _handle(p: Floats, rng: np.random.Generator, seed: int) -> Floats:
    """A round or blocky body with one to three handles, and now and then a hollow from above."""
    wide = rng.uniform(0.35, 0.55)
    body = sdf.ellipsoid(p, (0, 0, 0.7), (wide, wide, 0.9))
    if rng.uniform() < 0.5:
        body = sdf.box(p, (0, 0, 0.75), (wide, wide, 0.8), 0.1, sdf.rotation(rng.uniform(0, 90)))
    if rng.uniform() < 0.5:
        body = sdf.subtract(
            body, sdf.capsule(p, (0, 0, rng.uniform(0.6, 1.0)), (0, 0, 2.0), 0.65 * wide), 0.02
        )
    for _ in range(int(rng.integers(1, 4))):
        bearing, reach, radius = rng.uniform(0, 2 * np.pi), rng.uniform(0.7, 1.0), rng.uniform(0.06, 0.12)
        low, high = rng.uniform(0.2, 0.6), rng.uniform(0.9, 1.3)
        around = ((0.8 * wide, low), (reach, low + 0.1), (reach, high - 0.1), (0.8 * wide, high))
        knots = [(r * np.cos(bearing), r * np.sin(bearing), z) for r, z in around]
        bars = [sdf.capsule(p, a, b, radius) for a, b in pairwise(knots)]
        body = sdf.union(body, sdf.union_of(bars), 0.04)
    return body


def _plates(p: Floats, rng: np.random.Generator, seed: int) -> Floats:
    """Two to five thin plates through one another."""
    upright = sdf.rotation(rng.uniform(0, 180), *rng.uniform(-15, 15, 2))
    parts = [sdf.box(p, (0, 0, 0.75), (rng.uniform(0.03, 0.07), rng.uniform(0.3, 0.65), 0.85), 0.01, upright)]
    for _ in range(int(rng.integers(1, 5))):
        half = (rng.uniform(0.03, 0.07), *rng.uniform(0.3, 0.65, 2))
        at = (*rng.uniform(-0.25, 0.25, 2), rng.uniform(0.3, 1.2))
        lean = rng.uniform(-20, 20, 2) if rng.uniform() < 0.7 else (90.0, 0.0)
        parts.append(sdf.box(p, at, half, 0.01, sdf.rotation(rng.uniform(0, 180), *lean)))
    return sdf.union_of(parts)


def _machine(p: Floats, rng: np.random.Generator, seed: int) -> Floats:
    """A block or a drum with deep pockets from its sides and its top, some through it, with ribs or a boss."""
    wide, deep = rng.uniform(0.45, 0.75, 2)
    turn_deg = rng.uniform(0, 180)
    turn = sdf.rotation(turn_deg)
    if rng.uniform() < 0.6:
        body = sdf.box(p, (0, 0, 0.7), (wide, deep, 0.9), 0.03, turn)
    else:
        drum = np.hypot(p[:, 0], p[:, 1]) - wide
        body = sdf.intersection(drum, np.abs(p[:, 2] - 0.7) - 0.9, 0.03)
    q = p @ turn
    for _ in range(int(rng.integers(2, 5))):  # from a side
        axis, side = int(rng.integers(2)), rng.choice((-1.0, 1.0))
        depth_m = rng.uniform(0.3, 0.7) if rng.uniform() < 0.8 else 2.0  # else right through
        center, half = np.zeros(3), np.full(3, depth_m)
        center[axis] = side * (wide, deep)[axis]
        center[1 - axis], center[2] = rng.uniform(-0.2, 0.2), rng.uniform(0.3, 1.2)
        half[1 - axis], half[2] = rng.uniform(0.12, 0.3), rng.uniform(0.15, 0.4)
        body = sdf.subtract(body, sdf.box(q, center, half, 0.03), 0.01)
    if rng.uniform() < 0.6:  # from above
        half = np.array([*rng.uniform(0.15, 0.35, 2), rng.uniform(0.4, 1.1)])
        body = sdf.subtract(body, sdf.box(q, (*rng.uniform(-0.12, 0.12, 2), 1.6), half, 0.03), 0.01)
    if rng.uniform() < 0.5:
        rib = sdf.box(q, (0, 0, 0.5), (wide + rng.uniform(0.1, 0.25), rng.uniform(0.04, 0.09), 0.6), 0.01)
        body = np.minimum(body, rib)
    else:
        boss = sdf.capsule(
            q, (0.0, 0.0, 0.9), (0.0, deep + rng.uniform(0.1, 0.3), 0.9), rng.uniform(0.1, 0.18)
        )
        body = np.minimum(body, boss)
    return body


def _part(p: Floats, rng: np.random.Generator, seed: int) -> Floats:
    """A cast part with large faces: a block with slanting sides, hollow from above or from one side, with webs, or a bracket."""
    half = np.array([*rng.uniform(0.5, 0.85, 2), 0.8])
    q = p @ sdf.rotation(rng.uniform(0, 180))
    body = sdf.box(q, (0, 0, 0.75), half, 0.02)
    for _ in range(int(rng.integers(0, 3))):  # a large slanting face: up to the sky, or down to the ground
        normal = sdf.rotation(rng.uniform(0, 360), rng.uniform(-65, 25)) @ [1.0, 0.0, 0.0]
        body = np.maximum(body, sdf.half_space(q - [0, 0, 0.75], normal, rng.uniform(0.25, 0.5)))
    wall, floor, side = rng.uniform(0.06, 0.14), rng.uniform(0.15, 0.7), int(rng.integers(2))
    inside, middle = half - wall, np.array([0.0, 0.0, 0.8 + floor])
    inside[2] = 0.8
    if rng.uniform() < 0.5:  # a wall is missing: a bracket, or a channel
        middle[side] = rng.choice((-1.0, 1.0)) * half[side]
        inside[side] = rng.uniform(1.2, 1.8) * half[side]
    body = sdf.subtract(body, sdf.box(q, middle, inside, 0.03), 0.01)
    for _ in range(int(rng.integers(0, 3))):  # webs in the hollow
        web = [half[0], half[1], rng.uniform(0.25, 0.7)]
        web[int(rng.integers(2))] = rng.uniform(0.03, 0.06)
        shift = np.append(rng.uniform(-0.3, 0.3, 2), 0.0)
        inside_block = sdf.box(q, (0, 0, 0.75), half, 0.02)
        body = np.minimum(body, np.maximum(inside_block, sdf.box(q, shift, web, 0.01)))
    bore = (*rng.uniform(-0.3, 0.3, 2), 0.0)
    boss = sdf.capsule(q, bore, (*bore[:2], rng.uniform(0.5, 1.2)), rng.uniform(0.12, 0.22))
    return np.minimum(body, boss) if rng.uniform() < 0.5 else body


def _head(p: Floats, rng: np.random.Generator, seed: int) -> Floats:
    """A head with two large ears, eye sockets, a muzzle and a brow, on a neck or on the ground."""
    q = p @ sdf.rotation(rng.uniform(0, 360))
    wide, high, center = rng.uniform(0.36, 0.52), rng.uniform(0.42, 0.6), rng.uniform(0.75, 0.95)
    head = sdf.ellipsoid(q, (0, 0, center), (rng.uniform(0.38, 0.5), wide, high))
    neck = sdf.capsule(q, (-0.05, 0, 0.0), (0, 0, center), rng.uniform(0.18, 0.4))
    muzzle = sdf.ellipsoid(q, (0.4, 0, center - 0.2), (rng.uniform(0.15, 0.35), 0.22, 0.18))
    head = sdf.union(sdf.union(head, muzzle, 0.1), neck, 0.15)
    size, thick, up = rng.uniform(0.24, 0.42), rng.uniform(0.05, 0.1), np.deg2rad(rng.uniform(-10, 60))
    turn_deg, away = rng.uniform(-35, 35), 0.65 * size + 1 / np.hypot(np.cos(up) / wide, np.sin(up) / high)
    for s in (-1.0, 1.0):
        ear_m = np.array([-0.05, s * away * np.cos(up), center + away * np.sin(up)])
        turn = sdf.rotation(s * turn_deg)
        ear = sdf.ellipsoid(q, ear_m, (thick, size, size), turn)
        ear = sdf.subtract(
            ear, sdf.ellipsoid(q, ear_m + turn @ [thick, 0, 0], (thick, 0.8 * size, 0.8 * size), turn), 0.02
        )
        socket = sdf.ellipsoid(q, (0.42, s * 0.2, center + 0.12), (0.14, 0.12, 0.1))
        head = sdf.union(sdf.subtract(head, socket, 0.04), ear, 0.04)
    return head


def _animal(p: Floats, rng: np.random.Generator, seed: int) -> Floats:
    """A long body on four thin legs, with a neck, a head and a tail."""
    q = p @ sdf.rotation(rng.uniform(0, 360))
    long, stout, leg = rng.uniform(0.32, 0.46), rng.uniform(0.14, 0.26), rng.uniform(0.05, 0.09)
    belly = rng.uniform(0.8, 1.05)
    body = sdf.ellipsoid(q, (0, 0, belly), (long + 0.15, stout, stout))
    for x in (-0.8 * long, 0.8 * long):
        for y in (-0.7 * stout, 0.7 * stout):
            knee = (x + rng.uniform(-0.1, 0.1), 1.1 * y, 0.5 * belly)
            foot = (x + rng.uniform(-0.2, 0.2), y + rng.uniform(-0.08, 0.08), 0.0)
            bars = (sdf.capsule(q, (x, y, belly), knee, 1.3 * leg), sdf.capsule(q, knee, foot, leg))
            body = sdf.union(body, np.minimum(*bars), 0.06)
    head = (long + rng.uniform(0.1, 0.25), 0.0, rng.uniform(1.2, 1.45))
    body = sdf.union(body, sdf.capsule(q, (0.8 * long, 0, belly), head, 0.6 * stout), 0.08)
    snout = (head[0] + 0.22, 0.0, head[2] - rng.uniform(0.05, 0.2))
    body = sdf.union(body, sdf.capsule(q, head, snout, 0.55 * stout), 0.05)
    tail = (-long - rng.uniform(0.1, 0.3), 0.0, belly - rng.uniform(-0.3, 0.5))
    return sdf.union(body, sdf.capsule(q, (-long, 0, belly), tail, 0.05), 0.05)


def _lever(p: Floats, rng: np.random.Generator, seed: int) -> Floats:
    """A rocker arm, upright or lying: two bored eyes at the ends of a bar with an I section, and a bored hub."""
    q = (p - [0, 0, 0.75]) @ sdf.rotation(rng.uniform(0, 360), rng.uniform(-90, 10), rng.uniform(-90, 90))
    reach, wide, thin = rng.uniform(0.45, 0.65), rng.uniform(0.16, 0.3), rng.uniform(0.06, 0.14)
    bend = rng.uniform(0.0, 0.35)
    places = [np.array([reach, 0.0, -bend]), np.zeros(3), np.array([-reach, 0.0, -bend])]
    body = np.full(len(q), np.inf)
    for a, b in pairwise(places):
        middle, along = (a + b) / 2, a - b
        turn = sdf.rotation(0.0, np.rad2deg(np.arctan2(-along[2], along[0])))
        half = np.array([np.linalg.norm(along) / 2 + 0.05, wide, 0.6 * wide])
        bar = sdf.box(q, middle, half, 0.03, turn)
        for s in (-1.0, 1.0):
            groove = np.array([half[0] - 0.08, wide - thin / 2, 0.6 * wide - thin / 2])
            bar = sdf.subtract(bar, sdf.box(q, middle + np.array([0, s * wide, 0]), groove, 0.02, turn), 0.02)
        body = np.minimum(body, bar)
    for k, at in enumerate(places):
        radius, reach = rng.uniform(0.2, 0.32), (1.6 if k == 1 else 1.2) * wide
        local, axis = q - at, 1 if k == 1 else int(rng.integers(1, 3))
        across = np.delete(local, axis, axis=1)
        eye = sdf.intersection(np.linalg.norm(across, axis=1) - radius, np.abs(local[:, axis]) - reach, 0.02)
        body = sdf.subtract(sdf.union(body, eye, 0.06), np.linalg.norm(across, axis=1) - 0.6 * radius, 0.01)
    foot = sdf.ellipsoid(p, (0, 0, 0.0), (0.35, 0.35, 0.3))
    return sdf.union(sdf.union(body, foot, 0.05), sdf.capsule(p, (0, 0, 0), (0, 0, 0.6), 0.1), 0.05)


def _figure(p: Floats, rng: np.random.Generator, seed: int) -> Floats:
    """A smooth body that sits: trunk, haunches, a head on it, and now and then long ears, arms or shoulders."""
    q = p @ sdf.rotation(rng.uniform(0, 360))
    long, wide, high = rng.uniform(0.4, 0.65), rng.uniform(0.3, 0.5), rng.uniform(0.4, 0.6)
    body = sdf.ellipsoid(q, (-0.1, 0, 0.4), (long, wide, high))
    nod, size = rng.uniform(0.0, 0.45), rng.uniform(0.22, 0.36)
    head = np.array([nod, 0.0, rng.uniform(0.95, 1.2)])
    body = sdf.union(body, sdf.capsule(q, (0, 0, 0.4), head, 0.6 * size), 0.2)
    body = sdf.union(body, sdf.ellipsoid(q, head, (1.2 * size, 0.9 * size, size)), 0.12)
    ears, limbs = rng.uniform() < 0.5, int(rng.integers(0, 3))
    for s in (-1.0, 1.0):
        if ears:
            tip = head + np.array([-rng.uniform(0.1, 0.5), s * rng.uniform(0.1, 0.3), rng.uniform(0.3, 0.5)])
            body = sdf.union(
                body, sdf.capsule(q, head + np.array([0, 0.5 * s * size, 0.5 * size]), tip, 0.08), 0.06
            )
        for k in range(limbs):
            start, end = (
                (0.3 * k - 0.3, s * 0.8 * wide, 0.5),
                (0.5 * k + rng.uniform(-0.2, 0.3), s * wide, 0.05),
            )
            body = sdf.union(body, sdf.capsule(q, start, end, rng.uniform(0.1, 0.2)), 0.12)
    return body


# A body at points (N, 3) as a generator draws it, and what makes the family hard.
FAMILIES: dict[str, tuple[Callable[[Floats, np.random.Generator, int], Floats], str]] = {
    "boulder": (_boulder, "blocky, nearly convex"),
    "slab": (_slab, "leaning slab: an underside on one side, narrow edges"),
    "overhang": (_overhang, "a cap that hides stem and underside"),
    "cleft": (_cleft, "deep, narrow cracks"),
    "stack": (_stack, "blocks on one another, with ledges and gaps"),
    "breccia": (_breccia, "lobes with gaps between them"),
}

# Shapes that are no boulders.
SHAPES = {
    "mesa": (_mesa, "a level top with sharp edges"),
    "limbs": (_limbs, "legs and arms that hide one another"),
    "handle": (_handle, "handles, and a hollow from above"),
    "plates": (_plates, "thin plates with spaces between them"),
    "machine": (_machine, "deep pockets and holes in sides and top"),
    "part": (_part, "large faces that a ring sees at a grazing angle or not at all"),
    "head": (_head, "large thin ears, eye sockets"),
    "animal": (_animal, "thin legs under a body"),
    "lever": (_lever, "bored eyes and a grooved bar"),
    "figure": (_figure, "smooth, with hollows between its limbs"),
}
EVERY = {**FAMILIES, **SHAPES}
FAMILY_REGISTRY = Registry("families", EVERY)


def family_generator(family: str) -> tuple[Callable[[Floats, np.random.Generator, int], Floats], str] | None:
    """The function that draws a family's rocks, and a phrase on what makes them hard; None for an unknown family."""
    plugin = FAMILY_REGISTRY.plugin(family)
    if plugin is None:
        return EVERY.get(family)
    return plugin.loaded, (plugin.loaded.__doc__ or "").strip().partition("\n")[0]


def generated_recipe(family: str, seed: int) -> Recipe:
    """The rock that ``seed`` draws from ``family``; `UserError` where there is no such family or seed."""
    generator = family_generator(family)
    if generator is None:
        raise UserError(f"there is no family {family!r} of rocks; choose from {', '.join(FAMILY_REGISTRY)}")
    if not 0 <= seed < SEED_LIMIT:
        raise UserError(f"seed {seed} of family {family!r} is not from 0 to {SEED_LIMIT - 1}")
    draw, difficulty = generator
    # The seed's own stream in each family: families of one seed have nothing in common.
    rng = np.random.default_rng([seed, *family.encode()])
    is_shape = family in SHAPES
    lowest_m, highest_m = HEIGHT_M if not is_shape else (HEIGHT_M[0], HIGHEST_SHAPE_M)
    height_m = float(np.exp(rng.uniform(*np.log((lowest_m, highest_m)))))
    buried_m = rng.uniform(0, MOST_BURIED) * DEFAULT_HEIGHT_M
    tilt_deg, turn = rng.uniform(0, MOST_TILTED_DEG), sdf.rotation(rng.uniform(0, 360))
    tilt = turn @ sdf.rotation(0.0, tilt_deg) @ turn.T  # about a horizontal axis
    relief, richness = rng.uniform(0.6, 1.3) * (0.25 if is_shape else 1.0), rng.uniform()
    paint = Paint(rng.uniform(0.22, 0.45), richness, 0.15 + 0.6 * richness, 0.75 - 0.6 * richness)
    noise = int(rng.integers(1, 2**20))

    pivot = np.array([0.0, 0.0, DEFAULT_HEIGHT_M / 2])

    def shape(p: Floats) -> Floats:
        standing = (p - pivot) @ tilt + pivot + [0.0, 0.0, buried_m]
        drawn = np.random.default_rng([seed, 1, *family.encode()])
        return grounded(p, draw(warp(standing, noise, 0.04, 0.7), drawn, noise) + rough(p, noise, relief))

    split: Split = "train"
    if seed >= VALIDATION_FROM:
        split = "validation" if seed < HELD_OUT_FROM else "held-out"
    return Recipe(split, noise, difficulty, shape, paint, height_m)


def generated_name(name: str) -> tuple[str, int] | None:
    """``(family, seed)`` where ``name`` is that of a generated rock, such as ``cleft-3``; else None."""
    match = _NAME.fullmatch(name)
    return (match[1], int(match[2])) if match and family_generator(match[1]) else None
