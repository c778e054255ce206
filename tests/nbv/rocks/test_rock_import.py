"""Importing meshes: colours land where they belong, and bad files are told apart in one line."""

import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from nbv.errors import UserError
from nbv.rocks import describe, import_mesh


def write_box_obj(folder: Path) -> Path:
    """A 1 x 1 x 1 box, each face of which shows the lower left quarter of ``box.png``."""
    (folder / "box.mtl").write_text("newmtl skin\nKd 1 1 1\nmap_Kd box.png\n")
    lines, k = ["mtllib box.mtl", "usemtl skin"], 1
    for corners in (
        [(1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1)],
        [(1, 1, 0), (0, 1, 0), (0, 1, 1), (1, 1, 1)],
        [(0, 1, 0), (0, 0, 0), (0, 0, 1), (0, 1, 1)],  # west
        [(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)],
        [(0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)],
        [(0, 1, 0), (1, 1, 0), (1, 0, 0), (0, 0, 0)],
    ):
        for (x, y, z), uv in zip(corners, ("0 0", "0.5 0", "0.5 0.5", "0 0.5")):
            lines += [f"v {x} {y} {z}", f"vt {uv}"]
        a, b, c, d = (f"{k + i}/{k + i}" for i in range(4))
        lines += [f"f {a} {b} {c}", f"f {a} {c} {d}"]
        k += 4
    path = folder / "box.obj"
    path.write_text("\n".join(lines) + "\n")
    return path


SMALL_M = 0.4  # a quarter of the usual height has a sixteenth of the faces


def small(path: Path, **options):
    return import_mesh(path, height_m=SMALL_M, **options)


def test_texture_is_not_mirrored_and_is_linear(tmp_path):
    """A horizontal and a vertical ramp on a wall are found again, as linear values."""
    y, x = np.mgrid[:256, :256]
    image = np.stack([x, 255 - y, np.full_like(x, 128)], axis=-1).astype(np.uint8)
    Image.fromarray(image).save(tmp_path / "box.png")
    rock = small(write_box_obj(tmp_path))
    facts = describe(rock)
    assert facts["boundary_edges"] == 0  # the 24 vertices became 8
    assert facts["mean_edge_m"] < 0.006 * 1.2

    def linear(v):
        return ((v + 0.055) / 1.055) ** 2.4 if v > 0.04045 else v / 12.92

    # The west wall shows u and v from 0 to 0.5; seen from outside, u grows towards the south.
    for along, up in ((0.25, 0.25), (0.7, 0.4), (0.5, 0.9)):
        point = np.multiply(SMALL_M, (-0.5, 0.5 - along, up))
        nearest = np.argmin(np.linalg.norm(rock.vertices_m - point, axis=1))
        expected = [linear(0.5 * along), linear(0.5 * up), linear(128 / 255)]
        np.testing.assert_allclose(rock.albedo[nearest], expected, atol=0.01)


def test_glb_is_turned_upright_and_its_scene_graph_is_applied(tmp_path):
    box = trimesh.creation.box(extents=(1, 2, 1))  # 2 along the file's y axis, glTF's up
    scene = trimesh.Scene()
    scene.add_geometry(box, transform=trimesh.transformations.translation_matrix([5, 7, 9]))
    scene.export(tmp_path / "Tall Rock.glb")
    rock = small(tmp_path / "Tall Rock.glb")
    assert rock.name == "tall-rock"
    assert describe(rock)["extents_m"] == pytest.approx((0.2, 0.2, 0.4), abs=1e-6)
    assert rock.vertices_m.min(0)[2] == 0 and any("y axis is up" in note for note in rock.notes)
    flat = small(tmp_path / "Tall Rock.glb", up="z")
    assert describe(flat)["extents_m"] == pytest.approx((0.4, 0.8, 0.4), abs=1e-5)


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
    hull.export(tmp_path / "cone.stl")
    rock = small(tmp_path / "cone.stl", up=up, name="cone")
    top = rock.vertices_m[np.argmax(rock.vertices_m[:, 2])]
    assert top[2] == pytest.approx(SMALL_M)
    assert np.isclose(rock.vertices_m[:, 2], 0).sum() > 50  # the ring is the base
    assert describe(rock)["volume_m3"] == pytest.approx(hull.volume * (SMALL_M / 2) ** 3, rel=1e-6)


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
    "rock.xyzzy": ("hello", "is not of a format that is read"),
    "comment.obj": ("# nothing here\n", "holds no faces|cannot be read"),
    "points.ply": (trimesh.PointCloud(np.eye(3)), "holds no faces"),
    "nan.obj": ("v 0 0 0\nv nan 0 1\nv 0 1 0\nv 1 1 1\nf 1 2 3\nf 1 2 4\n", "not finite"),
    "plane.obj": ("v 0 0 0\nv 1 0 1\nv 0 1 0\nv 1 1 1\nf 1 2 3\nf 2 4 3\n", "flat"),
    "vast.obj": (
        "v 0 0 0\nv 1e160 0 0\nv 0 1e160 0\nv 0 0 1e160\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n",
        "coordinate of 1e.160; the limit is",
    ),
    "line.obj": ("v 0 0 0\nv 1 0 1\nv 2 0 2\nf 1 2 3\n", "zero area"),
    "point.obj": ("v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "coincide|zero area"),
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


def test_side_files_are_regular_and_in_the_mesh_s_folder(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    path = tmp_path / "in" / "box.gltf"
    for name, data in trimesh.exchange.gltf.export_gltf(trimesh.creation.box().scene()).items():
        (path if name == "model.gltf" else path.with_name(name)).write_bytes(data)
    buffer, *_ = sorted(path.parent.glob("*.bin"))
    assert len(small(path).faces) >= 12
    whole = path.read_text()
    buffer.rename(tmp_path / "outside.bin")
    os.mkfifo(buffer)
    for name, says in ((buffer.name, "not a regular file"), ("../outside.bin", "cannot be read")):
        path.write_text(whole.replace(buffer.name, name))
        with pytest.raises(UserError, match=says):
            import_mesh(path)


@pytest.mark.parametrize("name", ["rock.zip", "rock.ply.gz"])
def test_what_is_packed_is_refused(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("rock.ply", bytes(2**20))
    with pytest.raises(UserError, match="is packed; unpack it, or export the mesh as GLB, OBJ, PLY or STL"):
        import_mesh(path)


def test_a_texture_of_very_many_pixels_is_not_unpacked(tmp_path: Path) -> None:
    path = write_box_obj(tmp_path)
    Image.new("1", (13_000, 13_000)).save(tmp_path / "box.png")
    with pytest.raises(UserError, match=r"pixels is 1.69e\+08; the limit is 1e\+08"):
        import_mesh(path)
