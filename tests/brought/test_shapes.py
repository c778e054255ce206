"""Faces and bodies as other tools write them: read right, or refused in our words."""

import struct

import numpy as np
import pytest
import trimesh
from refusals import refused

from nbv.errors import UserError
from nbv.rocks import describe, import_mesh, importer


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    monkeypatch.setattr(importer, "MAX_EDGE_M", 0.1)


# An L of concave polygons, 3 wide, 1.2 deep, 2.5 high: area 22.2, volume 5.4. Polygons name its corners, from 0.
SIDE = [(0, 0), (3, 0), (3, 1), (1, 1), (1, 2.5), (0, 2.5)]
CORNERS = [(x, y, z) for y in (0, 1.2) for x, z in SIDE]
POLYGONS = [
    [1, 2, 3, 4, 5, 0],
    [7, 6, 11, 10, 9, 8],
    *([k, (k - 1) % 6, 6 + (k - 1) % 6, 6 + k] for k in range(6)),
]
TRIANGLES = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5], [8, 7, 6], [9, 8, 6], [10, 9, 6], [11, 10, 6]]
TRIANGLES += [triangle for a, b, c, d in POLYGONS[2:] for triangle in ([a, b, c], [a, c, d])]
MIXED = [*TRIANGLES[:-2], POLYGONS[-1]]
BEYOND = [*TRIANGLES, [0, 1, 20]]


def l_obj(faces=TRIANGLES, first=1, gap=" ", end="\n", indent="", point=".") -> str:
    lines = [gap.join(["v", *(f"{x:.3f}".replace(".", point) for x in corner)]) for corner in CORNERS]
    lines += [gap.join(["f", *(str(k + first) for k in face)]) for face in faces]
    return "".join(indent + line + end for line in lines)


def two_relative() -> str:
    faces = "".join("f " + " ".join(str(k - 12) for k in face) + "\n" for face in TRIANGLES)
    corners = [
        "".join(f"v {x + dx} {y + dy} {z}\n" for x, y, z in CORNERS) for dx, dy in ((0, 0), (0.5, 1.2))
    ]
    return f"o a\n{corners[0]}{faces}o b\n{corners[1]}{faces}"


def l_ply(faces=TRIANGLES, binary=False, point=".") -> bytes:
    head = [
        "ply",
        f"format {'binary_little_endian' if binary else 'ascii'} 1.0",
        f"element vertex {len(CORNERS)}",
    ]
    head += [f"property float {axis}" for axis in "xyz"]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header\n"]
    if binary:
        body = np.array(CORNERS, "<f4").tobytes()
        body += b"".join(struct.pack(f"<B{len(face)}i", len(face), *face) for face in faces)
    else:
        body = numbers(faces, point).encode()
    return "\n".join(head).encode() + body


def l_off(faces=TRIANGLES, color="", kind="OFF", point=".", end="\n") -> str:
    return f"{kind}\n{len(CORNERS)} {len(faces)} 0\n{numbers(faces, point, color)}".replace("\n", end)


def numbers(faces, point, color="") -> str:
    lines = [" ".join(f"{x:.3f}" for x in corner).replace(".", point) + color for corner in CORNERS]
    return "\n".join([*lines, *(" ".join(map(str, [len(face), *face])) for face in faces)]) + "\n"


MORE = "faces of more than three corners"
NOT_HELD = "name vertices (that )?it does not hold"
SHAPES = {
    "polygons.obj": (l_obj(POLYGONS), 22.2, 5.4),
    "continued.obj": (l_obj(POLYGONS).replace("f 2 3 4 ", "f 2 3 4 \\\n"), 22.2, 5.4),
    "tabs.obj": (l_obj(gap="\t"), 22.2, 5.4),
    "cr.obj": (l_obj(end="\r"), 22.2, 5.4),
    "comma.obj": (l_obj(point=","), 22.2, 5.4),
    "relative.obj": (two_relative(), 44.4, 10.8),
    "indented.obj": (l_obj(indent="  "), "indented lines, which are not read; export it again"),
    "from_0.obj": (l_obj(first=0), "counts vertices from 0, where OBJ begins with 1; export it again"),
    "beyond.obj": (l_obj(BEYOND), NOT_HELD),
    "triangles.ply": (l_ply(), 22.2, 5.4),
    "binary.ply": (l_ply(binary=True), 22.2, 5.4),
    "polygons.ply": (l_ply(POLYGONS), MORE),
    "binary_mixed.ply": (l_ply(MIXED, binary=True), MORE),
    "beyond.ply": (l_ply(BEYOND), NOT_HELD),
    "binary_beyond.ply": (l_ply(BEYOND, binary=True), NOT_HELD),
    "negative.ply": (l_ply([*TRIANGLES, [0, 1, -3]]), NOT_HELD),
    "comma.ply": (l_ply(point=","), "has decimal commas; export it with decimal points"),
    "cut_off.ply": (l_ply(binary=True)[:-40], "damaged or cut off"),
    "triangles.off": (l_off(), 22.2, 5.4),
    "colours.off": (l_off(color=" 255 0 0 255", kind="COFF"), 22.2, 5.4),
    "polygons.off": (l_off(POLYGONS), MORE),
    "beyond.off": (l_off(BEYOND), "cannot be read"),
}


@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_is_read_right_or_refused_in_our_words(tmp_path, name):
    content, *right = SHAPES[name]
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    if isinstance(right[0], str):
        with pytest.raises(UserError, match=right[0]) as caught:
            import_mesh(tmp_path / name)
        assert "\n" not in str(caught.value) and name in str(caught.value)
        return
    rock = import_mesh(tmp_path / name)
    facts, scale = describe(rock), 1.6 / 2.5
    assert (facts["area_m2"], facts["volume_m3"]) == pytest.approx(
        (right[0] * scale**2, right[1] * scale**3), rel=1e-4
    )
    told = "colours of OFF are not read" if name.endswith(".off") else "no texture"
    assert any(told in note for note in rock.notes)


# The one of most surface is not the first in the file.
BODIES = [
    trimesh.creation.box(extents=(2, 1, 2)),
    trimesh.creation.icosphere(subdivisions=2, radius=0.5).apply_translation((1.2, 0, 0)),
]


@pytest.fixture
def scan(tmp_path, monkeypatch):
    monkeypatch.setattr(importer, "MAX_EDGE_M", 0.3)
    trimesh.util.concatenate(BODIES[::-1]).export(tmp_path / "scan.ply")
    return tmp_path / "scan.ply"


@pytest.mark.parametrize(("body", "kept"), [(None, BODIES), (1, BODIES[:1]), (2, BODIES[1:])])
def test_all_bodies_are_the_target_or_one_is(scan, body, kept):
    rock, truth = import_mesh(scan, body=body), trimesh.util.concatenate(kept)
    scale = 1.6 / truth.extents[2]
    facts = describe(rock)
    np.testing.assert_allclose(facts["extents_m"], truth.extents * scale, atol=1e-3)
    assert facts["area_m2"] == pytest.approx(truth.area * scale**2, rel=1e-3)
    share = 100 * BODIES[0].area / sum(part.area for part in BODIES)
    [listed] = [note for note in rock.notes if note.startswith("2 bodies")]
    assert f"1: 2 x 1 x 2, {share:.1f} %" in listed and f"2: 1 x 1 x 1, {100 - share:.1f} %" in listed


def test_a_body_that_is_not_there(scan):
    for body, says in ((3, "has no body 3; it has 2"), (0, "the largest is 1")):
        refused(says, import_mesh, scan, body=body)


def test_what_reaches_too_far_names_the_bodies(tmp_path):
    parts = [
        trimesh.creation.box(extents=(9, 9, 0.1)),
        trimesh.creation.box().apply_translation((0, 0, 0.55)),
    ]
    trimesh.util.concatenate(parts).export(tmp_path / "plate.ply")
    refused(r"into the viewpoints.*--body N.*2: 1 x 1 x 1", import_mesh, tmp_path / "plate.ply")
