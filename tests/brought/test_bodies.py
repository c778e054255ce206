"""Meshes of several bodies: the object is kept whole, and what it stands on or before, specks and hidden bodies are left out and named."""

import itertools
import re

import numpy as np
import pytest
import trimesh

from nbv.errors import UserError
from nbv.rocks import describe, import_mesh, importer


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    monkeypatch.setattr(importer, "MAX_EDGE_M", 0.3)


def stone(x=0.0, y=0.0, z=0.0, size=1.0, seed=0):
    """A bumpy ball on z, ``size`` wide and high."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    p, rng = ball.vertices, np.random.default_rng(seed)
    p = p * (1 + 0.1 * np.sin(3 * p @ rng.normal(size=(3, 1)) + rng.uniform(0, 6)))
    p = (p - p.min(axis=0)) / np.ptp(p, axis=0).max() - (0.5, 0.5, 0)
    return trimesh.Trimesh(p * size + (x, y, z), ball.faces, process=False)


def box(sx, sy, sz, x=0.0, y=0.0, top=0.0, tilt_deg=0.0):
    made = trimesh.creation.box(extents=(sx, sy, sz))
    made.apply_translation((x, y, top - sz / 2))
    return made.apply_transform(trimesh.transformations.rotation_matrix(np.deg2rad(tilt_deg), (1, 0, 0)))


def turned(mesh, deg):
    return mesh.apply_transform(trimesh.transformations.rotation_matrix(np.deg2rad(deg), (0, 0, 1)))


def sheet(width, bumps=0.0, flip=False, cells=20):
    side = np.linspace(-width / 2, width / 2, cells)
    x, y = (a.ravel() for a in np.meshgrid(side, side))
    z = bumps * np.random.default_rng(0).normal(size=len(x))
    k = (np.arange(cells - 1)[:, None] * cells + np.arange(cells - 1)).ravel()
    faces = np.concatenate(
        [np.stack([k, k + 1, k + cells], 1), np.stack([k + 1, k + cells + 1, k + cells], 1)]
    )
    return trimesh.Trimesh(np.stack([x, y, z], 1), faces[:, ::-1] if flip else faces, process=False)


def drum(radius, height, top=0.0):
    made = trimesh.creation.cylinder(radius, height, sections=24)
    return made.apply_translation((0, 0, top - height / 2))


def tiny(count, at=1.0):
    rng = np.random.default_rng(1)
    return [
        trimesh.creation.icosphere(subdivisions=0, radius=0.01).apply_translation(
            rng.normal(size=3) * 0.3 * at + (0, 0, at)
        )
        for _ in range(count)
    ]


def corner():
    """A floor and a wall in one body."""
    points = [(-2, 1, 0), (2, 1, 0), (2, -3, 0), (-2, -3, 0), (-2, 1, 3), (2, 1, 3)]
    return trimesh.Trimesh(points, [(0, 2, 1), (0, 3, 2), (0, 1, 5), (0, 5, 4)], process=False)


PAIR = [stone(-0.45), stone(0.45, seed=1, size=0.9)]
POT = [drum(0.5, 1.0, 1.0), drum(0.45, 0.25, 1.26), box(0.3, 0.1, 0.5, x=0.64, top=0.8)]
DOLMEN = [box(0.3, 0.9, 1, -0.5, top=1), box(0.3, 0.9, 1, 0.5, top=1), stone(0, 0, 0.98, 1.6)]
# What is the object, what lies beside it, and what the notes say of the latter.
CASES = {
    "on a plate": ([stone()], [box(6, 6, 0.1)], "left out the ground, 6 x 6 x 0.1 .*--keep all"),
    "on a disc": ([stone()], [drum(2, 0.05)], "left out the ground"),
    "on a small disc": ([stone()], [drum(0.75, 0.05)], "left out the ground"),
    "on a turned plate": ([stone()], [turned(box(2, 1.5, 0.1), 30)], "left out the ground"),
    "on a leaning plate": ([stone(z=0.05)], [box(4, 4, 0.1, tilt_deg=8)], "left out the ground"),
    "on bumpy ground": ([stone(z=-0.1)], [sheet(5, 0.05)], "left out the ground"),
    "on a sheet that faces down": ([stone()], [sheet(5, flip=True)], "left out the ground"),
    "on two very large triangles": ([stone()], [sheet(200, cells=2)], "left out the ground"),
    "sunk in the ground": ([stone(z=-0.3)], [sheet(5)], "left out the ground"),
    "two on a plate": (PAIR, [box(6, 6, 0.1)], "left out the ground"),
    "on a plinth": ([stone()], [box(1.3, 1.3, 1.2)], "left out a plinth, 1.3 x 1.3 x 1.2 .* % of the surface"),
    "on a round plinth": ([stone()], [drum(0.7, 1.5)], "left out a plinth"),
    "on a plinth on a plate": ([stone(z=1)], [box(1.2, 1.2, 1, top=1), box(5, 5, 0.1)], "a plinth.*the ground|the ground.*a plinth"),
    "before a wall": ([stone()], [box(4, 0.2, 3, y=1.2, top=2.5)], "left out a wall"),
    "before a wall, on the ground": ([stone()], [box(4, 0.2, 3, y=1.2, top=3), box(4, 4, 0.1)], "left out a wall"),
    "before a sheet": ([stone()], [turned(box(0.01, 5, 4, x=2, top=3), 40)], "left out a wall"),
    "in a corner": ([stone()], [corner()], "left out"),
    "two that lean": (PAIR, [], ""),
    "pot with lid and handle": (POT, [], ""),
    "a stone on two": (DOLMEN, [], ""),
    "a stone on a stone": ([stone(), stone(z=0.97, size=0.5)], [], ""),
    "a slab on a stone": ([stone(), box(1.5, 1.5, 0.2, top=1.19)], [], ""),
    "a turned body": ([PAIR[0], PAIR[1].copy().apply_transform(np.eye(4))], [], ""),
    "specks": (PAIR, tiny(20), r"dropped 20 bodies \(.* under 1 % of the surface each"),
    "far away": ([stone()], [stone(x=5, size=0.8)], r"dropped 1 body \(.* out of reach"),
    "inside": ([stone()], [stone(z=0.25, size=0.5)], r"dropped 1 body \(.* inside others"),
    "all at once": (PAIR, [box(6, 6, 0.1), *tiny(20), stone(x=40, size=0.8)], "the ground.*out of reach.*under 1 %"),
}  # fmt: skip
CASES["a turned body"][0][1].invert()


@pytest.mark.parametrize(("case", "suffix"), [*zip(CASES, itertools.cycle([".ply", ".glb"]))])
def test_the_object_is_kept(tmp_path, case, suffix):
    own, others, says = CASES[case]
    whole = trimesh.util.concatenate([*others, *own])
    if suffix == ".glb":  # y is up
        whole.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0)))
    whole.export(tmp_path / f"scan{suffix}")
    rock = import_mesh(tmp_path / f"scan{suffix}")
    truth = trimesh.util.concatenate(own)
    scale = 1.6 / truth.extents[2]
    facts = describe(rock)
    np.testing.assert_allclose(facts["extents_m"], truth.extents * scale, atol=1e-3)
    volume = sum(abs(body.volume) for body in own) * scale**3
    assert (facts["area_m2"], facts["volume_m3"]) == pytest.approx((truth.area * scale**2, volume), rel=1e-3)
    said = "; ".join(rock.notes)
    assert re.search(says, said), said
    assert says or ("left out" not in said and "dropped" not in said)
    if len(own) > 1:
        assert re.search(rf"kept {len(own)} bodies \(.* % of the surface\)", said)


def test_a_surface_in_very_many_pieces(tmp_path):
    ball = stone()
    ball.vertices = ball.vertices[ball.faces].reshape(-1, 3) + np.random.default_rng(0).normal(
        scale=1e-4, size=(3 * len(ball.faces), 3)
    )
    ball.faces = np.arange(len(ball.vertices)).reshape(-1, 3)
    ball.export(tmp_path / "pieces.ply")
    rock = import_mesh(tmp_path / "pieces.ply")
    assert describe(rock)["area_m2"] == pytest.approx(
        stone().area * (1.6 / stone().extents[2]) ** 2, rel=0.02
    )


@pytest.mark.parametrize(("keep", "bodies"), [("all", 3), ("largest", 1), ("2", 2), ("7", 3)])
def test_keep(tmp_path, keep, bodies):
    parts = [box(2, 2, 0.2), stone(), stone(x=1.2, size=0.5)]
    trimesh.util.concatenate(parts[::-1]).export(tmp_path / "scan.ply")
    rock = import_mesh(tmp_path / "scan.ply", keep=keep, height_m=0.2)
    truth = trimesh.util.concatenate(parts[:bodies])
    assert describe(rock)["area_m2"] == pytest.approx(truth.area * (0.2 / truth.extents[2]) ** 2, rel=1e-3)


@pytest.mark.parametrize("keep", ["none", "0", "-1", "1.5", "", "1" * 30])
def test_keep_is_a_word_or_a_number(tmp_path, keep):
    with pytest.raises(UserError, match=r"keep is .*allowed: auto, all, largest, or a number"):
        import_mesh(tmp_path / "scan.ply", keep=keep)
