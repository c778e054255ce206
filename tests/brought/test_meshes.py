"""Meshes as other tools write them: a ball whose four quarters have colours of their own comes out as one, or one line says why not."""

from __future__ import annotations

import base64
import io
import json
import re
import struct
import sys
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


def picture(swap: bool = False) -> Image.Image:
    return Image.fromarray(
        np.kron(
            COLORS[[1, 0, 3, 2] if swap else [0, 1, 2, 3]].reshape(2, 2, 3), np.ones((16, 16, 1), np.uint8)
        )
    )


def png(**options) -> bytes:
    file = io.BytesIO()
    picture(**options).save(file, "PNG")
    return file.getvalue()


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    monkeypatch.setattr(importer, "MAX_EDGE_M", 0.1)


def look_right(path: Path) -> tuple[str, ...]:
    """Import, compare shape and colours with the truth, and return the notes."""
    rock = import_mesh(path)
    size = np.ptp(rock.vertices_m, axis=0)
    np.testing.assert_allclose(size / size[2], np.ptp(POINTS, axis=0) / 1.6, atol=0.01)
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


NUMBERS = ["f", "b", "B", "h", "H"]


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    suffix=st.sampled_from([".glb", ".gltf"]),
    points=st.sampled_from(["f", "h", "H", "raw"]),
    carried=st.sampled_from(["texture", "colors", "both"]),
    numbers=st.sampled_from([*NUMBERS, "raw"]),
    turn=st.sampled_from([0.0, 0.3, np.pi / 2, -2.0]),
    scale=st.tuples(st.floats(0.8, 3), st.floats(0.8, 3)),
    further=st.booleans(),
    sparse=st.booleans(),
    stride=st.sampled_from([0, 4]),
    alpha=st.booleans(),
)
def test_gltf_of_any_numbers(
    tmp_path, suffix, points, carried, numbers, turn, scale, further, sparse, stride, alpha
):
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
        rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        offset = 0.5 - rotation @ (np.array(scale) * 0.5)
        uv = np.linalg.solve(rotation, (UV - offset).T).T / scale
        k = 5000 if numbers == "raw" else 1
        move = {"offset": list(offset), "rotation": turn, "scale": [s / k for s in scale]}
        name = f"TEXCOORD_{int(further)}"
        kind = "H" if numbers == "raw" else numbers
        attributes[name] = file.accessor(uv * k, kind, normalized=numbers not in ("f", "raw"), **layout)
        if further:
            attributes["TEXCOORD_0"] = file.accessor(np.zeros_like(uv))
            move["texCoord"] = 1
        file.textured({"extensions": {"KHR_texture_transform": move}})
        file.tree["extensionsUsed"] = ["KHR_texture_transform", "KHR_mesh_quantization"]
    if carried != "texture":  # linear; of a texture's they are a factor
        colors = np.ones((len(SRGB), 3)) if carried == "both" else SRGB / 255.0
        colors = np.column_stack([colors, np.ones(len(colors))]) if alpha else colors
        kind = numbers if numbers in "fBH" else "H"
        attributes["COLOR_0"] = file.accessor(colors, kind, normalized=kind != "f", **layout)
    notes = look_right(file.write(tmp_path / f"ball{suffix}"))
    assert not any("not read" in note for note in notes)


def draco(file: Gltf) -> None:
    import DracoPy

    data = DracoPy.encode(UP_Y, FACES, tex_coord=UV, preserve_order=True, quantization_bits=16)
    ids = {a["attribute_type"]: a["unique_id"] for a in DracoPy.decode(data).attributes}
    kind = DracoPy.AttributeType
    where = {"POSITION": ids[kind.POSITION], "TEXCOORD_0": ids[kind.TEX_COORD]}
    file.primitive["extensions"] = {
        "KHR_draco_mesh_compression": {"bufferView": file.view(data), "attributes": where}
    }
    file.primitive["indices"] = file.accessor(FACES.reshape(-1), "I")
    for accessor in file.tree["accessors"]:
        accessor.pop("bufferView")


def colored_material(file: Gltf) -> None:
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


def under_a_camera(file: Gltf) -> None:
    file.tree["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}]
    file.tree["nodes"] = [{"camera": 0, "children": [1], "scale": [2, 2, 2]}, {"mesh": 0}]


def edit(**changes):
    return lambda file: file.tree.update(changes)


def no_decoder(file: Gltf) -> None:
    file.primitive["extensions"] = {
        "KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}
    }


def meshopt(file: Gltf) -> None:
    file.tree["bufferViews"][0]["extensions"] = {"EXT_meshopt_compression": {}}
    file.tree["extensionsRequired"] = ["EXT_meshopt_compression"]


# What is changed in a plain file, and what a note or the refusal then says; "" where nothing is to be said.
GLTF = {
    "draco": (draco, ""),
    "colours with a material": (colored_material, ""),
    "colours of materials": (factors, ""),
    "specular glossiness": (gloss, ""),
    "mirrored beyond 1": (wrapped(33648), ""),
    "repeated beyond 1": (wrapped(10497), ""),
    "clamped": (clamped, ""),
    "fans": (fans, ""),
    "under a camera": (under_a_camera, ""),
    "no scene": (lambda f: [f.tree.pop(k) for k in ("scene", "scenes")], ""),
    "extension that may be left out": (edit(extensionsUsed=["EXT_mesh_gpu_instancing"]), "not read: EXT_mesh_gpu_instancing"),
    "draco that is none": (no_decoder, "cannot be read: KHR_draco_mesh_compression: Input mesh is not draco encoded"),
    "meshopt": (meshopt, "compressed with EXT_meshopt_compression, which is not read; export it without"),
    "extension that must be read": (edit(extensionsRequired=["NGA_gpm"]), "needs the glTF extension NGA_gpm"),
    "nodes in a circle": (edit(nodes=[{"mesh": 0, "children": [1]}, {"children": [0]}]), "node 0 twice in its scene or in a circle"),
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


def test_draco_without_its_decoder(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    file = plain()
    draco_free = file.write(tmp_path / "ball.glb")
    look_right(draco_free)
    no_decoder(file)
    with pytest.raises(UserError, match=r"pip install 'gatetune\[draco\]'"):
        import_mesh(file.write(tmp_path / "ball.glb"))
