"""Rocks that are drawn, and meshes that are imported."""

import hashlib
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from refusals import refused
from textured_ball import PICTURE, write_ball

from nbv.errors import UserError
from nbv.rocks import describe, import_mesh, importer, load_coarse_rock, load_rock
from nbv.rocks.families import EVERY, generated_name, generated_recipe
from nbv.rocks.procedural import generate_rock
from nbv.rocks.recipes import RECIPES

SMALL_M = 0.4  # a quarter of the usual height has a sixteenth of the faces


def small(path: Path, **options):
    return import_mesh(path, height_m=SMALL_M, **options)


def test_texture_is_not_mirrored_and_is_linear(tmp_path):
    """A horizontal and a vertical ramp are found again, as linear values."""
    y, x = np.mgrid[:256, :256]
    ramps = np.stack([x, 255 - y, np.full_like(x, 128)], axis=-1).astype(np.uint8)
    rock = small(write_ball(tmp_path, Image.fromarray(ramps)))
    assert describe(rock)["boundary_edges"] == 0
    assert np.linalg.norm(np.diff(rock.vertices_m[rock.faces], axis=1), axis=2).max() <= 0.009
    u, v = (rock.vertices_m[:, 1:] / SMALL_M + (0.5, 0.0)).T
    expected = np.column_stack([u, v, np.full_like(u, 128 / 255)])
    expected = np.where(expected > 0.04045, ((expected + 0.055) / 1.055) ** 2.4, expected / 12.92)
    np.testing.assert_allclose(rock.albedo, expected, atol=0.01)


def test_thin_faces_do_not_multiply_without_end(tmp_path, monkeypatch):
    monkeypatch.setattr(importer, "MAX_FINE_FACES", 40_000)
    faces = {}
    for sections in (6, 200):  # 300,000 faces of the second, for as much surface
        trimesh.creation.cylinder(radius=0.5, height=1.6, sections=sections).export(tmp_path / "c.ply")
        rock = small(tmp_path / "c.ply")
        faces[sections] = len(rock.faces)
        told = [note for note in rock.notes if "thin faces: subdivided to" in note]
        edge_m = np.linalg.norm(np.diff(rock.vertices_m[rock.faces], axis=1), axis=2).max()
        assert (edge_m > 0.009) == bool(told) == (sections == 200)
    assert 15_000 < faces[200] < 60_000


@pytest.mark.parametrize("up", ["x", "-y", "-z"])
def test_up_axis_comes_out_on_top_without_mirroring(tmp_path, up):
    # A cone whose tip points along `up`; the tip must end at the top.
    axis = "xyz".index(up[-1])
    tip = np.zeros(3)
    tip[axis] = -1 if up[0] == "-" else 1
    others = [i for i in range(3) if i != axis]
    ring = np.zeros((4, 3))
    ring[:, others] = [[1, 0.2], [0, 1], [-1, 0], [0, -1]]
    hull = trimesh.convex.convex_hull(np.vstack([ring, tip * 2]))
    hull.export(tmp_path / "A Cone.stl")
    rock = small(tmp_path / "A Cone.stl", up=up)
    assert rock.name == "a-cone"
    top = rock.vertices_m[np.argmax(rock.vertices_m[:, 2])]
    assert top[2] == pytest.approx(SMALL_M)
    assert np.isclose(rock.vertices_m[:, 2], 0).sum() > 50  # the ring is the base
    assert describe(rock)["volume_m3"] == pytest.approx(hull.volume * (SMALL_M / 2) ** 3, rel=1e-6)


def test_of_a_mesh_wider_than_the_crop_the_height_is_told_that_fits(tmp_path, monkeypatch):
    monkeypatch.setattr(importer, "MAX_EDGE_M", 0.05)
    path = tmp_path / "flat.stl"
    trimesh.creation.box(extents=(4.0, 2.0, 0.4)).export(path)
    wide = import_mesh(path, height_m=SMALL_M)
    note = next(note for note in wide.notes if "2.00 m sideways" in note)
    fits_m = float(note.split("a height of ")[1].split()[0])
    assert fits_m == pytest.approx(0.3)
    assert not any("sideways" in note for note in import_mesh(path, height_m=fits_m).notes)
    trimesh.creation.box(extents=(4.0, 2.0, 0.12)).export(path)
    assert not any("a height of" in note for note in import_mesh(path, height_m=0.12).notes)


def test_inside_out_and_mixed_winding_are_mended(tmp_path):
    box = trimesh.creation.icosphere(subdivisions=1)
    box.invert()
    box.export(tmp_path / "inverted.ply")
    assert describe(small(tmp_path / "inverted.ply"))["volume_m3"] > 0
    mixed = trimesh.creation.icosphere(subdivisions=1)
    faces = np.array(mixed.faces)
    faces[::3] = faces[::3, ::-1]
    trimesh.Trimesh(mixed.vertices, faces, process=False).export(tmp_path / "mixed.ply")
    good = describe(small(tmp_path / "inverted.ply"))["volume_m3"]
    rock = small(tmp_path / "mixed.ply")
    assert describe(rock)["volume_m3"] == pytest.approx(good)
    assert any("wound against" in note for note in rock.notes)


BAD_FILES = {
    "missing.obj": (None, "no mesh file"),
    "empty.obj": ("", "is empty"),
    "rock.zip": ("PK\5\6" + "\0" * 18, "is packed; unpack it, or export the mesh as GLB, OBJ, PLY or STL"),
    "points.ply": (trimesh.PointCloud(np.eye(3)), "holds no faces"),
    "nan.obj": ("v 0 0 0\nv nan 0 1\nv 0 1 0\nv 1 1 1\nf 1 2 3\nf 1 2 4\n", "not finite"),
    "plane.obj": ("v 0 0 0\nv 1 0 1\nv 0 1 0\nv 1 1 1\nf 1 2 3\nf 2 4 3\n", "flat"),
    "vast.obj": (
        "v 0 0 0\nv 1e16 0 0\nv 0 1e16 0\nv 0 0 1e16\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n",
        "coordinate of 1e.16; the limit is",
    ),
    "line.obj": ("v 0 0 0\nv 1 0 1\nv 2 0 2\nf 1 2 3\n", "zero area"),
    "wide.stl": (trimesh.creation.box(extents=(10, 10, 0.5)), "viewpoints"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_files_are_refused_in_one_line(tmp_path, name):
    content, reason = BAD_FILES[name]
    path = tmp_path / name
    if isinstance(content, str):
        path.write_text(content)
    elif content is not None:
        content.export(path)
    with pytest.raises(UserError, match=reason) as caught:
        import_mesh(path)
    assert "\n" not in str(caught.value)
    assert path.name in str(caught.value)


def test_a_texture_of_very_many_pixels_is_not_unpacked(tmp_path: Path) -> None:
    path = write_ball(tmp_path, Image.new("1", (1, 1)))
    Image.new("1", (13_000, 13_000)).save(tmp_path / PICTURE)
    refused(r"pixels is 1.69e\+08; the limit is 1e\+08", import_mesh, path)


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
    refused(r"no family 'pebble' of rocks; choose from boulder", generated_recipe, "pebble", 3)
    refused(r"seed -1 .* not from 0", generated_recipe, "slab", -1)
    refused(r"seed 99999999 .* not from 0", load_rock, "slab-99999999")


COARSER_M = 0.025


@pytest.mark.slow
def test_the_rocks_are_what_all_missions_flew_on():
    """A changed digest is a changed rock: every number that was measured on it would have to be measured anew."""
    rocks = {name: generate_rock(name, grid_m=COARSER_M) for name in RECIPES}
    assert len({rock.sha256 for rock in rocks.values()}) == len(rocks)
    digest = hashlib.sha256("".join(rock.sha256 for rock in rocks.values()).encode()).hexdigest()
    assert digest == "99ce682805b7b780208fa8349abfbee7b5d1ab0f53f8fbd01c4bd2be1ad66490"
    assert generate_rock("waist", grid_m=COARSER_M).sha256 == rocks["waist"].sha256
    facts = describe(rocks["mushroom"])
    assert facts["overhang_fraction"] > describe(rocks["boulder"])["overhang_fraction"]
    assert facts["boundary_edges"] == 0 and facts["albedo_contrast"] > 0.1
    assert 0.15 < np.mean(facts["mean_albedo"]) < 0.55
