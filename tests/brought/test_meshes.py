"""Meshes as other tools write them: a ball whose four quarters have colours of their own comes out as one, or one line says why not."""

import base64
import io
import json
import re
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from nbv.errors import UserError
from nbv.rocks import import_mesh, importer

KINDS = {"b": 5120, "B": 5121, "h": 5122, "H": 5123, "I": 5125, "f": 5126}  # of NumPy's, as glTF numbers them
BALL = trimesh.creation.icosphere(subdivisions=2)
POINTS = np.asarray(BALL.vertices)[BALL.faces].reshape(-1, 3) * (0.7, 0.6, 0.8)  # z is up
FACES = np.arange(len(POINTS)).reshape(-1, 3)
CENTERS = np.repeat(POINTS[FACES].mean(axis=1), 3, axis=0)
QUARTER = (CENTERS[:, 0] < 0) + 2 * (CENTERS[:, 2] < 0)
COLORS = np.array([(255, 0, 0), (0, 0, 255), (0, 255, 0), (255, 255, 255)], dtype=np.uint8)
SRGB = COLORS[QUARTER]
UV = np.stack(
    [np.where(CENTERS[:, 0] < 0, 0.75, 0.25), np.where(CENTERS[:, 2] < 0, 0.75, 0.25)], axis=1
)  # v down
UP_Y = POINTS[:, [0, 2, 1]] * (1, 1, -1)


def png() -> bytes:
    file = io.BytesIO()
    Image.fromarray(np.kron(COLORS.reshape(2, 2, 3), np.ones((16, 16, 1), np.uint8))).save(file, "PNG")
    return file.getvalue()


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    monkeypatch.setattr(importer, "MAX_EDGE_M", 0.1)


def look_right(path: Path) -> tuple[str, ...]:
    """Import, compare shape and colours with the truth, the latter unless a note says that they are not read; return the notes."""
    rock = import_mesh(path)
    size = np.ptp(rock.vertices_m, axis=0)
    np.testing.assert_allclose(size / size[2], np.ptp(POINTS, axis=0) / 1.6, atol=0.01)
    if any(note.startswith("not read") for note in rock.notes):
        assert "albedo: procedural, since the mesh's own was not read" in rock.notes
        return rock.notes
    at = rock.vertices_m - (0, 0, 0.8)
    clear = (np.abs(at[:, [0, 2]]) > 0.15).all(axis=1)
    truth = COLORS[(at[:, 0] < 0) + 2 * (at[:, 2] < 0)] / 255.0
    np.testing.assert_allclose(rock.albedo[clear], truth[clear], atol=0.03, err_msg=str(rock.notes))
    return rock.notes


class Gltf:
    """A glTF file, put together by hand: accessors as they are asked for."""

    def __init__(self) -> None:
        self.blob = b""
        self.tree: dict = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
        }
        self.tree |= {"accessors": [], "bufferViews": [], "extensionsUsed": []}
        self.primitive: dict = {"attributes": {}}
        self.tree["meshes"] = [{"primitives": [self.primitive]}]

    def view(self, data: bytes, **more) -> int:
        self.blob += b"\0" * (-len(self.blob) % 4)
        self.tree["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(self.blob), "byteLength": len(data)} | more
        )
        self.blob += data
        return len(self.tree["bufferViews"]) - 1

    def accessor(self, array, kind: str = "f", *, normalized=False, stride=0, sparse=False) -> int:
        array = np.asarray(array, dtype=float).reshape(len(array), -1)
        top = np.iinfo(kind).max if normalized else 1
        rows = (array * top if kind == "f" else np.rint(array * top)).astype(kind, order="C")
        told = {"componentType": KINDS[kind], "count": len(rows), "normalized": normalized}
        told["type"] = ["", "SCALAR", "VEC2", "VEC3", "VEC4"][rows.shape[1]]
        if sparse:
            index = self.view(np.arange(len(rows), dtype="I").tobytes())
            told["sparse"] = {"count": len(rows), "indices": {"bufferView": index, "componentType": 5125}}
            told["sparse"]["values"] = {"bufferView": self.view(rows.tobytes())}
        else:
            wide = rows.tobytes() if not stride else np.hstack(
                [rows.view(np.uint8).reshape(len(rows), -1), np.zeros((len(rows), stride), np.uint8)]
            ).tobytes()  # fmt: skip
            more = {"byteStride": rows.itemsize * rows.shape[1] + stride} if stride else {}
            told["bufferView"] = self.view(wide, **more)
        self.tree["accessors"].append(told)
        return len(self.tree["accessors"]) - 1

    def textured(self, info: dict | None = None, **sampler) -> None:
        self.tree["images"] = [{"bufferView": self.view(png()), "mimeType": "image/png"}]
        self.tree |= {"samplers": [sampler], "textures": [{"source": 0, "sampler": 0}]}
        texture = {"index": 0} | (info or {})
        self.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": texture}}]
        self.primitive["material"] = 0

    def write(self, path: Path) -> Path:
        blob = self.blob + b"\0" * (-len(self.blob) % 4)
        self.tree["buffers"] = [{"byteLength": len(blob)}]
        if path.suffix == ".gltf":
            self.tree["buffers"][0]["uri"] = (
                "data:application/octet-stream;base64," + base64.b64encode(blob).decode()
            )
            path.write_text(json.dumps(self.tree))
        else:
            text = json.dumps(self.tree).encode()
            text += b" " * (-len(text) % 4)
            sizes = struct.pack("<4sIIII", b"glTF", 2, 28 + len(text) + len(blob), len(text), 0x4E4F534A)
            path.write_bytes(sizes + text + struct.pack("<II", len(blob), 0x004E4942) + blob)
        return path


def plain() -> Gltf:
    file = Gltf()
    file.primitive["attributes"] = {"POSITION": file.accessor(UP_Y), "TEXCOORD_0": file.accessor(UV)}
    file.textured()
    return file


@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    suffix=st.sampled_from([".glb", ".gltf"]),
    points=st.sampled_from(["f", "h", "H", "raw"]),
    carried=st.sampled_from(["texture", "colors", "both"]),
    numbers=st.sampled_from(["f", "f", "B", "H"]),
    moved=st.booleans(),
    further=st.booleans(),
    material=st.booleans(),
    sparse=st.sampled_from([False, False, False, True]),
    stride=st.sampled_from([0, 4]),
    alpha=st.booleans(),
)
def test_gltf_of_any_numbers(
    tmp_path, suffix, points, carried, numbers, moved, further, material, sparse, stride, alpha
):
    """Right: textures that are moved or use another set of coordinates, numbers of any kind, sparse ones."""
    file, layout = Gltf(), {"sparse": sparse, "stride": 0 if sparse else stride}
    attributes = file.primitive["attributes"]
    if points == "raw":  # KHR_mesh_quantization
        attributes["POSITION"] = file.accessor((UP_Y + 1) * 20_000, "H", **layout)
        file.tree["nodes"][0] |= {"scale": [5e-5] * 3, "translation": [3, 1, 2]}
    elif points == "f":
        attributes["POSITION"] = file.accessor(UP_Y, **layout)
    else:
        attributes["POSITION"] = file.accessor((UP_Y + 1) / 2, points, normalized=True, **layout)
    if carried != "colors":
        uv, info = UV, {}
        if moved:
            turn = 0.5 if numbers == "f" else 0.0
            told = {"offset": [0.25, 0.2], "rotation": turn, "scale": [2.0, 0.8]}
            back = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
            uv, info = (
                ((UV - (0.25, 0.2)) @ back) / (2.0, 0.8),
                {"extensions": {"KHR_texture_transform": told}},
            )
        attributes[f"TEXCOORD_{int(further)}"] = file.accessor(uv, numbers, normalized=numbers != "f")
        if further:
            attributes["TEXCOORD_0"] = file.accessor(np.zeros_like(uv))
            info["texCoord"] = 1
        file.textured(info)
        file.tree["extensionsUsed"] = ["KHR_texture_transform", "KHR_mesh_quantization"]
    elif material:
        file.tree["materials"], file.primitive["material"] = [{"pbrMetallicRoughness": {}}], 0
    if carried != "texture":  # linear; of a texture's they are a factor
        colors = np.ones((len(SRGB), 3)) if carried == "both" else SRGB / 255.0
        colors = np.column_stack([colors, np.ones(len(colors))]) if alpha else colors
        attributes["COLOR_0"] = file.accessor(colors, numbers, normalized=numbers != "f")
    assert not [note for note in look_right(file.write(tmp_path / f"ball{suffix}")) if "not read" in note]


def colored_material(file: Gltf) -> None:  # as Blender writes it
    del file.primitive["attributes"]["TEXCOORD_0"]
    file.primitive["attributes"]["COLOR_0"] = file.accessor(SRGB / 255, "H", normalized=True)
    file.tree["materials"] = [{"pbrMetallicRoughness": {"roughnessFactor": 0.9}}]


def factors(file: Gltf) -> None:
    file.tree["materials"], primitives = [], []
    for k, color in enumerate(COLORS):
        primitives.append({"attributes": {"POSITION": file.accessor(UP_Y[k == QUARTER])}, "material": k})
        file.tree["materials"].append({"pbrMetallicRoughness": {"baseColorFactor": [*(color / 255.0), 1.0]}})
    file.tree["meshes"][0]["primitives"] = primitives


def gloss(file: Gltf) -> None:
    base = file.tree["materials"][0].pop("pbrMetallicRoughness")
    told = {"diffuseTexture": base["baseColorTexture"], "diffuseFactor": [1, 1, 1, 1]}
    file.tree["materials"][0]["extensions"] = {"KHR_materials_pbrSpecularGlossiness": told}


def wrapped(how: int):
    def change(file: Gltf) -> None:
        file.primitive["attributes"]["TEXCOORD_0"] = file.accessor({33648: 2 - UV, 10497: UV - 3}[how])
        file.tree["samplers"] = [{"wrapS": how, "wrapT": how}]

    return change


def clamped(file: Gltf) -> None:
    file.primitive["attributes"]["TEXCOORD_0"] = file.accessor((UV - 0.5) * 4 + 0.5)
    file.tree["samplers"] = [{"wrapS": 33071, "wrapT": 33071}]


def fans(file: Gltf) -> None:
    every = {**file.primitive, "mode": 6}
    index = [file.accessor(face, "H") for face in FACES]
    file.tree["meshes"][0]["primitives"] = [every | {"indices": i} for i in index]


def no_picture(file: Gltf) -> None:
    file.tree["images"][0]["mimeType"] = "image/ktx2"


def under_a_camera(file: Gltf) -> None:
    file.tree["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}]
    file.tree["nodes"] = [{"camera": 0, "children": [1], "scale": [2, 2, 2]}, {"mesh": 0}]


def edit(**changes):
    return lambda file: file.tree.update(changes)


def draco(file: Gltf) -> None:
    file.primitive["extensions"] = {
        "KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}
    }
    file.tree["extensionsUsed"] = ["KHR_draco_mesh_compression"]


def meshopt(file: Gltf) -> None:
    file.tree["bufferViews"][0]["extensions"] = {"EXT_meshopt_compression": {}}
    file.tree["extensionsRequired"] = ["EXT_meshopt_compression"]


def ktx2(*, fallback: bool):
    def change(file: Gltf) -> None:
        texture = file.tree["textures"][0]
        texture["extensions"] = {"KHR_texture_basisu": {"source": 0}}
        if not fallback:
            del texture["source"]
        file.tree["extensionsUsed" if fallback else "extensionsRequired"] = ["KHR_texture_basisu"]

    return change


# What is changed in a plain file, and what a note or the refusal then says; "" where nothing is to be said.
GLTF = {
    "draco": (draco, "needs the glTF extension KHR_draco_mesh_compression, which is not read; unpack it: npx @gltf-transform/cli dequantize IN.glb OUT.glb"),
    "colours with a material": (colored_material, ""),
    "colours of materials": (factors, ""),
    "specular glossiness": (gloss, "not read: colours and textures .*: npx @gltf-transform/cli metalrough IN.glb OUT.glb"),
    "mirrored beyond 1": (wrapped(33648), "not read: a texture that is clamped or mirrored; export it with coordinates from 0 to 1"),
    "repeated beyond 1": (wrapped(10497), ""),
    "clamped": (clamped, "not read: a texture that is clamped or mirrored"),
    "clamped, but within 0 to 1": (edit(samplers=[{"wrapS": 33071, "wrapT": 33071}]), ""),
    "fans": (fans, "has fans of triangles, which are not read; export single triangles"),
    "under a camera": (under_a_camera, "has meshes that hang from a camera, which are not read; export it without cameras"),
    "no scene": (lambda f: [f.tree.pop(k) for k in ("scene", "scenes")], "holds no faces in its scene"),
    "a picture of another format": (no_picture, "not read: colours and textures .a texture is missing, or of a format that is not read"),
    "extension that may be left out": (edit(extensionsUsed=["EXT_mesh_gpu_instancing"]), "not read: EXT_mesh_gpu_instancing"),
    "meshopt": (meshopt, "needs the glTF extension EXT_meshopt_compression, which is not read; unpack it: npx @gltf-transform/cli dequantize"),
    "textures for graphics cards": (ktx2(fallback=False), "not read: colours and textures .KHR_texture_basisu: export it with PNG or JPEG textures"),
    "textures for graphics cards, and a picture": (ktx2(fallback=True), ""),
    "extension that must be read": (edit(extensionsRequired=["NGA_gpm"]), "needs the glTF extension NGA_gpm"),
    "nodes in a circle": (edit(nodes=[{"mesh": 0, "children": [1]}, {"children": [0]}]), "node twice in its scene or in a circle"),
    "very many nodes": (edit(nodes=[{"mesh": 0}] * 200_000), "the number of nodes in .* is 200000; the limit is 20000"),
    "very many elements": (edit(accessors=[{"count": 10**10, "type": "VEC3", "componentType": 5126}]), "number of elements"),
    "no glTF": (edit(meshes=7), "is no valid glTF 2.0"),
}  # fmt: skip


@pytest.mark.parametrize("case", GLTF)
def test_gltf(tmp_path, case):
    change, says = GLTF[case]
    file = plain()
    change(file)
    path = file.write(tmp_path / "ball.glb")
    said = ""
    try:
        notes = look_right(path)
        said = "; ".join(note for note in notes if "not read" in note)
    except UserError as error:
        said = str(error)
    assert "\n" not in said
    if says:
        assert re.search(says, said), said
    else:
        assert not said


def obj(folder: Path, *, mtl="newmtl rock\nmap_Kd t.png\n", uses="rock", library="a.mtl", stored="a.mtl", texture="t.png",
        colors=None, uv=True) -> Path:  # fmt: skip
    """The ball as OBJ; v goes up there."""
    (folder / texture).parent.mkdir(exist_ok=True, parents=True)
    (folder / texture).write_bytes(png())
    (folder / stored).write_text(mtl)
    lines = [f"mtllib {library}"]
    for k, point in enumerate(POINTS):
        lines.append("v " + " ".join(f"{x:.9g}" for x in (*point, *(() if colors is None else colors[k]))))
    lines += [f"vt {u:.6f} {1 - v:.6f}" for u, v in UV] if uv else []
    for quarter in range(4):
        of = np.flatnonzero(QUARTER[FACES[:, 0]] == quarter)
        lines += [f"usemtl {uses}".format(quarter)] if uses else []
        lines += [
            "f " + " ".join(f"{i + 1}/{i + 1}" if uv else f"{i + 1}" for i in FACES[face]) for face in of
        ]
    (folder / "scan.obj").write_text("\n".join(lines) + "\n")
    return folder / "scan.obj"


COLOR_MTL = "".join(f"newmtl m{k}\nKd {c[0] / 255} {c[1] / 255} {c[2] / 255}\n" for k, c in enumerate(COLORS))
NOT_NAMED = "not read: materials: faces name none (usemtl), or one that the MTL file does not have"
OBJ = {
    "plain": ({}, ""),
    "no usemtl": ({"uses": ""}, NOT_NAMED),
    "file in another case": ({"library": "A.MTL"}, "not read: 'A.MTL' (cannot read"),
    "material in another case": ({"uses": "Rock"}, NOT_NAMED),
    "picture in another case": ({"mtl": "newmtl rock\nmap_Kd T.PNG\n"}, "not read: 'T.PNG' (cannot read"),
    "backslashes": ({"mtl": "newmtl rock\nmap_Kd textures\\t.png\n", "texture": "textures/t.png"}, ""),
    "spaces and a tab": ({"mtl": "newmtl rock\n\tmap_Kd\tmy  t.png  \n", "texture": "my  t.png"}, ""),
    "quotes": ({"mtl": 'newmtl rock\nmap_Kd "t.png"\n'}, "not read: '\"t.png\"' (cannot read"),
    "options": ({"mtl": "newmtl rock\nmap_Kd -s 2 2 1 t.png\n"}, "not read: '-s 2 2 1 t.png' (cannot read"),
    "options, and a colour": ({"mtl": "newmtl rock\nKd 1 1 1\nmap_Kd -s 2 2 1 t.png\n"}, "not read: '-s 2 2 1 t.png'"),
    "name with spaces": ({"uses": "my rock", "mtl": "newmtl my rock\nmap_Kd t.png\n"}, ""),
    "two libraries": ({"library": "b.mtl a.mtl"}, "not read: 'b.mtl a.mtl' (cannot read"),
    "library with spaces": ({"library": "my a.mtl", "stored": "my a.mtl"}, ""),
    "colours of materials": ({"uses": "m{}", "mtl": COLOR_MTL}, ""),
    "material that is not there": ({"uses": "stone"}, NOT_NAMED),
    "colours of materials that are not there": ({"uses": "n{}", "mtl": COLOR_MTL}, NOT_NAMED),
    "library that is not there": ({"library": "b.mtl"}, "not read: 'b.mtl' (cannot read"),
    "picture that is not there": ({"mtl": "newmtl rock\nmap_Kd x.png\n"}, "not read: 'x.png' (cannot read"),
    "picture that is not one": ({"mtl": "newmtl rock\nmap_Kd scan.obj\n"}, "not read: 'scan.obj' (no picture)"),
    "no coordinates": ({"uv": False}, "not read: a texture; the mesh has no coordinates for it"),
    "an ambient texture": ({"mtl": "newmtl rock\nmap_Ka t.png\n"}, "not read: 'a.mtl' (its textures are map_Ka; call them map_Kd"),
    "colours of vertices": ({"colors": SRGB / 255, "mtl": "newmtl rock\nKd 0.75 0.75 0.75\n"}, ""),
    "colours of vertices alone": ({"colors": SRGB / 255, "mtl": "", "uses": "", "uv": False}, ""),
    "colours to 255": ({"colors": SRGB / 1.05, "mtl": "newmtl rock\n"}, "not read: colours of vertices, which go beyond 1"),
}  # fmt: skip


@pytest.mark.parametrize("case", OBJ)
def test_obj(tmp_path, case):
    options, says = OBJ[case]
    notes = look_right(obj(tmp_path, **options))
    assert says in "; ".join(notes) and (says or not any("not read" in note for note in notes)), notes


def test_an_mtl_of_very_many_materials(tmp_path):
    many = "".join(f"newmtl m{k}\nKd 1 1 1\nmap_Kd none{k}.png\n" for k in range(100_000))
    path = obj(tmp_path, mtl=many + "newmtl rock\nmap_Kd t.png\n")
    assert "number of materials in a.mtl is 100001; the limit is 1000" in "".join(look_right(path))
    path.write_text(path.read_text() + "".join(f"usemtl m{k}\nf 1 2 3\n" for k in range(100_000)))
    with pytest.raises(UserError, match=r"materials that the OBJ file's faces name is 100001; the limit"):
        import_mesh(path)


def ply(
    path: Path, *, at=POINTS, colors="", of="vertex", texture=False, named=True, scale=1, prefix=""
) -> Path:
    """The ball as ASCII PLY; colours as numbers of the type ``colors``, from 0 to ``scale``."""
    told = [f"property {colors} {prefix}{c}" for c in ("red", "green", "blue")] if colors else []
    values = SRGB / 255 * scale if scale != 1 or colors in ("float", "double") else SRGB
    shown = [" " + " ".join(f"{x:g}" for x in row) if colors else "" for row in values]
    head = ["ply", "format ascii 1.0", *(["comment TextureFile t0.png"] if texture and named else [])]
    head += [f"element vertex {len(at)}", *(f"property double {axis}" for axis in "xyz")]
    head += [*(told if of == "vertex" else ()), f"element face {len(FACES)}"]
    head += ["property list uchar int vertex_indices"]
    head += ["property list uchar float texcoord", "property int texnumber"] if texture else []
    head += [*(told if of == "face" else ()), "end_header"]
    for k, point in enumerate(at):
        head.append(" ".join(f"{x:.17g}" for x in point) + (shown[k] if of == "vertex" else ""))
    for a, b, c in FACES:
        head.append(f"3 {a} {b} {c}" + " 6 0 0 1 0 1 1 0" * texture + (shown[a] if of == "face" else ""))
    path.write_text("\n".join(head) + "\n")
    return path


@pytest.mark.parametrize(
    ("options", "says"),
    [
        *[({"colors": "uchar", "of": of}, "") for of in ("vertex", "face")],
        *[({"colors": kind, "scale": scale}, f"not read: colours and textures ({kind} red: save them as uchar red, green and blue)")
          for kind, scale in [("ushort", 65535), ("float", 1), ("double", 255), ("int", 255)]],
        ({"colors": "uchar", "prefix": "diffuse_"}, "(uchar diffuse_red: save them"),
        ({"texture": True}, "not read: colours and textures (a texture of a PLY file: export it as GLB or OBJ)"),
        ({"texture": True, "named": False, "colors": "uchar"}, ""),
    ],
    ids=str,
)  # fmt: skip
def test_ply(tmp_path, options, says):
    path = ply(tmp_path / "ball.ply", **options)
    notes = look_right(path)
    assert says in "; ".join(notes) and (says or not any("not read" in note for note in notes))


FAR = np.array([512_345.6, 5_123_456.7, 300.1])
FORMATS = {
    "f": np.float32,
    "%g": lambda x: np.array([float(f"{v:g}") for v in x.ravel()]).reshape(x.shape),
    "%.1f": lambda x: x.round(1),
}


@pytest.mark.parametrize("suffix", [".ply", ".stl", ".obj", ".glb"])
@pytest.mark.parametrize("rounding", FORMATS)
def test_coordinates_far_away_in_coarse_steps(tmp_path, suffix, rounding):
    ball = trimesh.creation.icosphere(subdivisions=3)
    points = FORMATS[rounding](np.asarray(ball.vertices) * (0.7, 0.6, 0.8) + FAR).astype(float)
    path = tmp_path / f"far{suffix}"
    trimesh.Trimesh(points, ball.faces, process=False).export(path)
    with pytest.raises(
        UserError, match=r"coordinates in steps of .* % of its size: they were rounded so far from the origin"
    ):
        import_mesh(path)


def test_coordinates_far_away_that_are_fine(tmp_path):
    for scale, offset, told in ((1.0, FAR, False), (100.0, FAR / 5, True), (1.0, FAR * 0, False)):
        points = POINTS * scale + offset
        path = ply(tmp_path / "far.ply", at=points.astype(np.float32) if told else points)
        assert any("coordinates in steps" in note for note in import_mesh(path).notes) == told


@pytest.mark.parametrize("suffix", [".dae", ".3mf", ".step", ".fbx", ".usdz", ".las", ".xyz", ""])
def test_a_format_that_is_not_read(tmp_path, suffix):
    (tmp_path / f"scan{suffix}").write_bytes(b"PK\3\4 something")
    with pytest.raises(
        UserError, match=r"is not of a format that is read; export the mesh as GLB, OBJ, PLY, STL or OFF"
    ):
        import_mesh(tmp_path / f"scan{suffix}")
