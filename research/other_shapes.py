"""Shapes that are no rocks and that nothing was fitted to: solids of trimesh, put together, 1.6 m high.

`SEEN` were looked at while the prediction was mended, `KEPT` only once it was; `LATER` were drawn when `KEPT` had shown what is
open from above, and looked at once.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import trimesh
from trimesh import creation, transformations

from nbv.geometry.mesh import rest_on_ground, vertex_normals
from nbv.rocks.rock import DEFAULT_HEIGHT_M, Rock, make_rock
from nbv.rocks.texture import procedural_albedo

EDGE_M = 0.05
Part = trimesh.Trimesh


def box(
    size: tuple[float, float, float],
    at: tuple[float, float, float],
    yaw_deg: float = 0.0,
    pitch_deg: float = 0.0,
) -> Part:
    turn = transformations.euler_matrix(0.0, np.deg2rad(pitch_deg), np.deg2rad(yaw_deg))
    turn[:3, 3] = at
    return creation.box(size, turn)


def rod(a: tuple[float, float, float], b: tuple[float, float, float], radius: float) -> Part:
    return creation.cylinder(radius, segment=(a, b), sections=24)


def moved(part: Part, at: tuple[float, float, float], roll_deg: float = 0.0) -> Part:
    turn = transformations.euler_matrix(np.deg2rad(roll_deg), 0.0, 0.0)
    turn[:3, 3] = at
    part.apply_transform(turn)
    return part


def profile(*points: tuple[float, float]) -> Part:
    """Turned about the vertical; (radius, height) from the bottom to the top."""
    return creation.revolve(np.array(points), sections=48)


def table() -> list[Part]:
    legs = [box((0.12, 0.12, 1.5), (x, y, 0.75)) for x in (-0.6, 0.6) for y in (-0.45, 0.45)]
    return [*legs, box((1.5, 1.2, 0.12), (0, 0, 1.54))]


def chair() -> list[Part]:
    legs = [box((0.08, 0.08, 0.8), (x, y, 0.4)) for x in (-0.35, 0.35) for y in (-0.35, 0.35)]
    return [*legs, box((0.8, 0.8, 0.08), (0, 0, 0.8)), box((0.06, 0.8, 0.85), (-0.37, 0, 1.2))]


def ring() -> list[Part]:
    return [moved(creation.torus(0.6, 0.2, 48, 24), (0, 0, 0.8), 80.0), box((0.9, 0.5, 0.12), (0, 0, 0.06))]


def mug() -> list[Part]:
    cup = profile((0, 0), (0.55, 0), (0.55, 1.6), (0.45, 1.6), (0.45, 0.15), (0, 0.15))
    ear = moved(creation.torus(0.4, 0.09, 40, 16), (0, 0.55, 0.8))
    ear.apply_transform(transformations.rotation_matrix(np.pi / 2, (0, 1, 0), (0, 0.55, 0.8)))
    return [cup, ear]


def stairs() -> list[Part]:
    return [box((0.3, 1.0, 0.32 * (k + 1)), (-0.6 + 0.3 * k, 0, 0.16 * (k + 1))) for k in range(5)]


def goblet() -> list[Part]:
    return [
        profile(
            (0, 0),
            (0.5, 0),
            (0.45, 0.08),
            (0.09, 0.15),
            (0.09, 0.8),
            (0.55, 1.1),
            (0.6, 1.6),
            (0.54, 1.6),
            (0.48, 1.15),
            (0, 0.95),
        )
    ]


def flange() -> list[Part]:
    hub = moved(creation.cylinder(0.35, 1.6, sections=40), (0, 0, 0.8))
    return [
        hub,
        moved(creation.cylinder(0.85, 0.25, sections=48), (0, 0, 0.5)),
        moved(creation.cylinder(0.6, 0.2, sections=48), (0, 0, 1.5)),
    ]


def beast() -> list[Part]:
    body = moved(creation.icosphere(3, 0.4), (0, 0, 0))
    body.apply_scale((1.8, 0.8, 0.8))
    body.apply_translation((0, 0, 0.9))
    legs = [rod((x, y, 0.9), (1.1 * x, 1.1 * y, 0), 0.1) for x in (-0.45, 0.45) for y in (-0.2, 0.2)]
    return [
        body,
        *legs,
        rod((0.5, 0, 1.0), (0.8, 0, 1.5), 0.12),
        moved(creation.icosphere(3, 0.22), (0.88, 0, 1.5)),
        rod((-0.6, 0, 1.0), (-1.0, 0, 1.3), 0.05),
    ]


def cactus() -> list[Part]:
    arms = [
        rod((0, 0, 0.7), (0.55, 0, 0.7), 0.13),
        rod((0.55, 0, 0.65), (0.55, 0, 1.2), 0.13),
        rod((0, 0, 0.9), (-0.3, 0.4, 0.9), 0.11),
        rod((-0.3, 0.4, 0.85), (-0.3, 0.4, 1.4), 0.11),
    ]
    return [rod((0, 0, 0), (0, 0, 1.6), 0.2), *arms]


def corner() -> list[Part]:
    return [
        box((1.3, 1.3, 0.06), (0, 0, 0.4)),
        box((1.3, 0.06, 1.5), (0, -0.2, 0.8)),
        box((0.06, 1.3, 1.6), (0.1, 0, 0.8)),
    ]


def ball() -> list[Part]:
    return [creation.icosphere(4, 0.8)]


def cone() -> list[Part]:
    return [creation.cone(0.8, 1.6, sections=48)]


def pipe() -> list[Part]:
    return [creation.annulus(0.5, 0.65, 1.6, sections=48)]


def knot() -> list[Part]:
    t = np.linspace(0, 2 * np.pi, 61)
    path = 0.27 * np.column_stack(
        [np.sin(t) + 2 * np.sin(2 * t), 1.2 * np.sin(3 * t), np.cos(t) - 2 * np.cos(2 * t)]
    )
    return [rod(tuple(a), tuple(b), 0.14) for a, b in pairwise(path)]


def crate() -> list[Part]:
    return [box((1.1, 0.9, 1.6), (0, 0, 0.8), 20.0)]


def sign() -> list[Part]:
    return [
        rod((0, 0, 0), (0, 0, 1.6), 0.06),
        box((0.05, 1.1, 0.7), (0.08, 0, 1.2), 0.0),
        box((0.7, 0.7, 0.1), (0, 0, 0.05)),
    ]


def vase() -> list[Part]:
    return [
        profile(
            (0, 0),
            (0.3, 0),
            (0.55, 0.5),
            (0.5, 0.9),
            (0.2, 1.3),
            (0.32, 1.6),
            (0.26, 1.6),
            (0.14, 1.3),
            (0, 0.3),
        )
    ]


def bridge() -> list[Part]:
    return [box((0.35, 0.7, 1.2), (x, 0, 0.6)) for x in (-0.7, 0.7)] + [box((1.9, 0.7, 0.4), (0, 0, 1.4))]


def dumbbell() -> list[Part]:
    balls = [moved(creation.icosphere(3, r), (0, 0, z)) for r, z in ((0.45, 0.45), (0.4, 1.5))]
    return [*balls, rod((0, 0, 0.4), (0, 0, 1.5), 0.14)]


def wheel() -> list[Part]:
    angles = np.deg2rad(np.arange(0, 360, 60))
    spokes = [rod((0, 0, 0.8), (0.7 * np.cos(a), 0, 0.8 + 0.7 * np.sin(a)), 0.05) for a in angles]
    return [
        moved(creation.torus(0.7, 0.1, 48, 20), (0, 0, 0.8), 90.0),
        *spokes,
        box((0.6, 0.5, 0.1), (0, 0, 0.05)),
    ]


def bench() -> list[Part]:
    legs = [box((0.1, 0.6, 0.75), (x, 0, 0.37)) for x in (-0.8, 0.8)]
    return [*legs, box((1.9, 0.7, 0.08), (0, 0, 0.78)), box((1.9, 0.06, 0.75), (0, 0.33, 1.2))]


def pyramid() -> list[Part]:
    return [creation.cone(1.0, 1.6, sections=4)]


def lamp() -> list[Part]:
    foot = moved(creation.cylinder(0.4, 0.1, sections=40), (0, 0, 0.05))
    shade = moved(creation.cone(0.55, 0.7, sections=40), (0, 0, 0.95))
    return [foot, rod((0, 0, 0), (0, 0, 1.5), 0.06), shade]


def pill() -> list[Part]:
    return [creation.capsule(0.8, 0.4)]


def anvil() -> list[Part]:
    return [
        box((0.9, 0.7, 0.35), (0, 0, 0.17)),
        box((0.45, 0.4, 0.8), (0, 0, 0.7)),
        box((1.4, 0.55, 0.45), (0, 0, 1.3)),
        rod((0.6, 0, 1.35), (1.05, 0, 1.4), 0.14),
    ]


def helix() -> list[Part]:
    t = np.linspace(0, 4 * np.pi, 49)
    path = np.column_stack([0.5 * np.cos(t), 0.5 * np.sin(t), 0.12 + 1.4 * t / t[-1]])
    return [rod(tuple(a), tuple(b), 0.12) for a, b in pairwise(path)]


def fan() -> list[Part]:
    blades = [
        box((0.75, 0.05, 1.5), (0.4 * np.cos(a), 0.4 * np.sin(a), 0.8), np.rad2deg(a))
        for a in np.deg2rad((0, 72, 144, 216, 288))
    ]
    return [rod((0, 0, 0), (0, 0, 1.6), 0.1), *blades]


def tree() -> list[Part]:
    places = ((0, 0, 1.2, 0.4), (0.4, 0.1, 1.0, 0.3), (-0.35, 0.2, 1.05, 0.3), (0.0, -0.4, 0.95, 0.28))
    crown = [moved(creation.icosphere(3, r), (x, y, z)) for x, y, z, r in places]
    return [rod((0, 0, 0), (0, 0, 1.2), 0.12), *crown]


def shelf() -> list[Part]:
    boards = [box((1.2, 0.45, 0.05), (0, 0, z)) for z in (0.1, 0.6, 1.1, 1.57)]
    return [*boards, *(box((0.05, 0.45, 1.6), (x, 0, 0.8)) for x in (-0.6, 0.6))]


def bucket() -> list[Part]:
    hoop = moved(creation.torus(0.6, 0.05, 48, 16), (0, 0, 0.95), 90.0)
    return [profile((0, 0), (0.4, 0), (0.62, 1.0), (0.56, 1.0), (0.36, 0.06), (0, 0.06)), hoop]


def gear() -> list[Part]:
    teeth = [
        box((0.25, 0.2, 0.7), (0.8 * np.cos(a), 0.8 * np.sin(a), 0.5), np.rad2deg(a))
        for a in np.deg2rad(np.arange(0, 360, 36))
    ]
    return [
        moved(creation.cylinder(0.72, 0.7, sections=48), (0, 0, 0.5)),
        *teeth,
        rod((0, 0, 0), (0, 0, 1.6), 0.2),
    ]


def star() -> list[Part]:
    ends = (
        (0.8, 0, 0.8),
        (-0.8, 0, 0.8),
        (0, 0.8, 0.8),
        (0, -0.8, 0.8),
        (0, 0, 0),
        (0, 0, 1.6),
        (0.5, 0.5, 1.3),
        (-0.5, -0.5, 1.3),
        (0.5, -0.5, 0.3),
    )
    return [rod((0, 0, 0.8), end, 0.14) for end in ends]


def armchair() -> list[Part]:
    return [
        box((0.9, 1.0, 0.5), (0, 0, 0.3)),
        box((0.2, 1.0, 1.6), (-0.45, 0, 0.8)),
        *(box((0.9, 0.18, 0.9), (0, y, 0.45)) for y in (-0.5, 0.5)),
    ]


def hourglass() -> list[Part]:
    return [
        profile(
            (0, 0),
            (0.6, 0),
            (0.6, 0.1),
            (0.45, 0.4),
            (0.08, 0.8),
            (0.45, 1.2),
            (0.6, 1.5),
            (0.6, 1.6),
            (0, 1.6),
        )
    ]


def mushroom() -> list[Part]:
    return [
        profile((0, 0), (0.25, 0), (0.18, 0.4), (0.2, 0.95), (0.75, 0.9), (0.8, 1.05), (0.55, 1.4), (0, 1.6))
    ]


def sofa() -> list[Part]:
    return [
        box((0.8, 1.8, 0.5), (0, 0, 0.3)),
        box((0.25, 1.8, 1.2), (-0.5, 0, 0.6)),
        *(box((0.9, 0.2, 0.8), (0, y, 0.4)) for y in (-0.95, 0.95)),
    ]


def cross() -> list[Part]:
    return [
        box((0.3, 0.3, 1.6), (0, 0, 0.8)),
        box((0.3, 1.2, 0.3), (0, 0, 1.1)),
        box((0.7, 0.7, 0.15), (0, 0, 0.07)),
    ]


def spool() -> list[Part]:
    return [
        moved(creation.cylinder(0.8, 0.2, sections=48), (0, 0, 0.1)),
        moved(creation.cylinder(0.35, 1.4, sections=48), (0, 0, 0.8)),
        moved(creation.cylinder(0.8, 0.2, sections=48), (0, 0, 1.5)),
    ]


def barrel() -> list[Part]:
    return [
        profile(
            (0, 0),
            (0.5, 0),
            (0.62, 0.5),
            (0.65, 0.8),
            (0.62, 1.1),
            (0.5, 1.6),
            (0.45, 1.6),
            (0.45, 1.55),
            (0, 1.55),
        )
    ]


def castle() -> list[Part]:
    wall = [profile((0, 0), (0.6, 0), (0.6, 1.35), (0.45, 1.35), (0.45, 1.05), (0, 1.05))]
    return [
        *wall,
        *(
            box((0.16, 0.22, 0.3), (0.52 * np.cos(a), 0.52 * np.sin(a), 1.45), np.rad2deg(a))
            for a in np.deg2rad(np.arange(0, 360, 45))
        ),
    ]


def car() -> list[Part]:
    wheels = [
        rod((x, y - 0.09, 0.25), (x, y + 0.09, 0.25), 0.25) for x in (-0.55, 0.55) for y in (-0.45, 0.45)
    ]
    return [box((1.9, 0.8, 0.5), (0, 0, 0.5)), box((1.0, 0.7, 0.5), (-0.1, 0, 0.95)), *wheels]


def boat() -> list[Part]:
    hull = profile(
        (0, 0), (0.35, 0.05), (0.6, 0.35), (0.7, 0.9), (0.64, 0.9), (0.54, 0.4), (0.3, 0.15), (0, 0.12)
    )
    hull.apply_scale((1.3, 0.75, 1.0))
    return [hull, rod((0, 0, 0.1), (0, 0, 1.6), 0.05)]


def ladder() -> list[Part]:
    return [
        rod((-0.35, 0, 0), (-0.35, 0.5, 1.6), 0.06),
        rod((0.35, 0, 0), (0.35, 0.5, 1.6), 0.06),
        rod((-0.35, 1.0, 0), (-0.35, 0.5, 1.6), 0.06),
        rod((0.35, 1.0, 0), (0.35, 0.5, 1.6), 0.06),
        *(
            rod((-0.35, 0.5 * k / 5, 1.6 * k / 5), (0.35, 0.5 * k / 5, 1.6 * k / 5), 0.05)
            for k in range(1, 5)
        ),
    ]


def rocket() -> list[Part]:
    return [
        profile((0, 0.2), (0.3, 0.2), (0.35, 0.7), (0.3, 1.2), (0, 1.6)),
        *(
            box((0.45, 0.05, 0.5), (0.4 * np.cos(a), 0.4 * np.sin(a), 0.25), np.rad2deg(a))
            for a in np.deg2rad((0, 90, 180, 270))
        ),
    ]


def umbrella() -> list[Part]:
    return [
        profile((0, 1.25), (0.75, 1.05), (0.78, 1.1), (0.5, 1.4), (0, 1.6)),
        rod((0, 0, 0), (0, 0, 1.4), 0.05),
        box((0.5, 0.5, 0.1), (0, 0, 0.05)),
    ]


def funnel() -> list[Part]:
    return [
        profile(
            (0, 0),
            (0.4, 0),
            (0.4, 0.08),
            (0.12, 0.15),
            (0.12, 0.6),
            (0.75, 1.6),
            (0.68, 1.6),
            (0.06, 0.65),
            (0, 0.65),
        )
    ]


def fence() -> list[Part]:
    posts = [box((0.1, 0.16, 1.6), (0, y, 0.8)) for y in np.linspace(-0.9, 0.9, 6)]
    return [*posts, *(box((0.06, 2.0, 0.14), (0.06, 0, z)) for z in (0.4, 1.2))]


def crown() -> list[Part]:
    return [
        box((1.2, 0.3, 0.7), (0, 0, 0.35)),
        *(rod((x, 0, 0.6), (1.2 * x, 0, 1.6), 0.1) for x in (-0.5, -0.17, 0.17, 0.5)),
        box((0.5, 1.1, 0.3), (0, 0, 0.15)),
    ]


SEEN = (
    table, chair, ring, mug, stairs, goblet, flange, beast,
    cactus, corner, ball, cone, pipe, knot, crate, sign,
)  # fmt: skip
KEPT = (
    vase, bridge, dumbbell, wheel, bench, pyramid, lamp, pill,
    anvil, helix, fan, tree, shelf, bucket, gear, star,
)  # fmt: skip
LATER = (
    armchair, hourglass, mushroom, sofa, cross, spool, barrel, castle,
    car, boat, ladder, rocket, umbrella, funnel, fence, crown,
)  # fmt: skip
SHAPES: dict[str, Callable[[], list[Part]]] = {make.__name__: make for make in (*SEEN, *KEPT, *LATER)}


def load_shape(name: str, store: object = None) -> Rock:
    """The shape called ``name`` as a rock."""
    parts = SHAPES[name]()
    whole = trimesh.util.concatenate(parts)
    vertices, _ = rest_on_ground(np.asarray(whole.vertices, dtype=float), DEFAULT_HEIGHT_M)
    vertices, faces = trimesh.remesh.subdivide_to_size(vertices, whole.faces, EDGE_M, max_iter=60)
    vertices, faces = np.asarray(vertices), np.asarray(faces, dtype=np.int64)
    albedo = procedural_albedo(vertices, vertex_normals(vertices, faces), sum(name.encode()))
    return make_rock(name, vertices, faces, albedo, split="held-out", difficulty="")
