"""glTF rewritten so that trimesh reads it as the standard means it: numbers, texture coordinates, a tree of nodes.

trimesh reads the scene, the buffers, Draco and the pictures. It takes normalised numbers raw and passes over sparse
accessors, `KHR_texture_transform`, further sets of texture coordinates and colours beside a texture. So the file gets a
new header, whose primitives carry an extension that does this when they are read.
"""

from __future__ import annotations

import functools
import importlib.util
import json
import struct
from collections.abc import Mapping
from typing import Any

import lazy_loader
import numpy as np

from nbv.errors import UserError
from nbv.rocks.materials import COLOR, UV, Material, UnusableMesh
from nbv.safe_files import MIB, parse_json, require
from nbv.types import Floats

trimesh: Any = lazy_loader.load("trimesh")  # half a second, and most commands read no mesh
MAX_HEADER_BYTES = 64 * MIB
MAX_VALUES = 5_000_000
MAX_NODES = 20_000  # a few seconds
MAX_ELEMENTS = 200_000_000  # of all accessors, before memory is taken
_DRACO, _GLOSS = "KHR_draco_mesh_compression", "KHR_materials_pbrSpecularGlossiness"
EXTENSION = "GATETUNE_as_meant"
_READ = {_DRACO, "KHR_texture_transform", "KHR_mesh_quantization", "EXT_texture_webp"}
_TYPES: dict[int, type[Any]] = {
    5120: np.int8,
    5121: np.uint8,
    5122: np.int16,
    5123: np.uint16,
    5125: np.uint32,
    5126: np.float32,
}
_WRAP = {33071: "clamp", 33648: "mirror"}


def rewritten_gltf(content: bytes, source: str, notes: list[str]) -> tuple[bytes, dict[str, Material]]:
    """The file with a header that trimesh reads as glTF 2.0 means it, and its materials by number.

    `UnusableMesh` where it is no glTF, or needs what is not read; `UserError` where it is too large, or its decoder is not
    installed.
    """
    binary = content[:4] == b"glTF"
    start, end = (20, 20 + int.from_bytes(content[12:16], "little")) if binary else (0, len(content))
    require(end - start, MAX_HEADER_BYTES, f"the size of the header of {source} in bytes")
    try:
        header = parse_json(content[start:end].decode("utf-8-sig"), source, MAX_VALUES)
        materials = _rewrite(header, source, notes)
    except (KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
        raise UnusableMesh(
            f"is no valid glTF 2.0 ({type(error).__name__}: {error}); export it again"
        ) from error
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    if not binary:
        return text, materials
    sizes = struct.pack("<II", 20 + len(text) + len(content) - end, len(text))
    return content[:8] + sizes + content[16:20] + text + content[end:], materials


def _rewrite(header: dict[str, Any], source: str, notes: list[str]) -> dict[str, Material]:
    needed = set(header.get("extensionsRequired", ()))
    views, accessors = header.get("bufferViews", ()), header.get("accessors", [])
    primitives = [p for mesh in header.get("meshes", ()) for p in mesh["primitives"]]
    others = {
        name for name in needed.union(header.get("extensionsUsed", ())) - _READ if "materials" not in name
    }
    packed = {name for view in views for name in view.get("extensions", ()) if "meshopt" in name}
    for name in packed or needed & others:
        how = "is compressed with" if packed else "needs"
        raise UnusableMesh(f"{how} the glTF extension {name}, which is not read; export it without")
    if others:
        notes.append(f"glTF extensions that are not read: {', '.join(sorted(others))}")
    if any(p.get("targets") for p in primitives) or header.get("skins"):
        notes.append("skins and morph targets are not read: the mesh is as it is stored")
    if any(_DRACO in p.get("extensions", ()) for p in primitives) and not importlib.util.find_spec("DracoPy"):
        raise UserError(
            f"{source} is compressed with Draco, whose decoder is an extra; install it: pip install 'gatetune[draco]'"
        )
    total = sum(int(a["count"]) * len(a["type"]) for a in accessors)  # len: 4 to 6, for 1 to 16 numbers
    require(total, MAX_ELEMENTS, f"the number of elements that {source} tells of")
    _check_tree(header, source)
    bases = [_base_color(material) for material in header.get("materials", ())]
    # A factor stays here: trimesh rounds it.
    header["materials"] = [
        {"name": str(i), "pbrMetallicRoughness": {"baseColorTexture": texture} if texture else {}}
        for i, (texture, _) in enumerate(bases)
    ]
    for p in primitives:
        texture, factor = bases[p["material"]] if "material" in p else (None, None)
        indices = [*p["attributes"].values(), *([p["indices"]] if "indices" in p else [])]
        told = {str(i): accessors[i] for i in indices}
        extension = {EXTENSION: {"accessors": told, "texture": texture, "factor": factor}}
        p["extensions"] = {k: v for k, v in p.get("extensions", {}).items() if k == _DRACO} | extension
    _register()
    return {str(i): _material(header, texture) for i, (texture, _) in enumerate(bases)}


def _base_color(material: dict[str, Any]) -> tuple[dict[str, Any] | None, list[float] | None]:
    """The texture and the linear factor that a material's colour is the product of."""
    if (gloss := material.get("extensions", {}).get(_GLOSS)) is not None:
        return gloss.get("diffuseTexture"), gloss.get("diffuseFactor")
    base = material.get("pbrMetallicRoughness", {})
    return base.get("baseColorTexture"), base.get("baseColorFactor")


def _check_tree(header: dict[str, Any], source: str) -> None:
    """Raise where the scene's nodes are very many or no tree, and give it the nodes of a file without a scene."""
    nodes = header.get("nodes", [])
    require(len(nodes), MAX_NODES, f"the number of nodes in {source}")
    for node in nodes:
        node.pop("camera", None)  # trimesh leaves out what hangs from a camera
    if not header.get("scenes"):
        below = {child for node in nodes for child in node.get("children", ())}
        header["scenes"], header["scene"] = [{"nodes": sorted(set(range(len(nodes))) - below)}], 0
    waiting, seen = list(header["scenes"][header.get("scene", 0)].get("nodes", ())), set[int]()
    while waiting:
        index = waiting.pop()
        if index in seen:
            raise UnusableMesh(f"has node {index} twice in its scene or in a circle; export it again")
        seen.add(index)
        waiting += nodes[index].get("children", ())


def _material(header: dict[str, Any], texture: Mapping[str, Any] | None) -> Material:
    if texture is None:
        return Material()
    found = header["textures"][texture["index"]]
    sampler = header["samplers"][found["sampler"]] if "sampler" in found else {}
    index = found.get("extensions", {}).get("EXT_texture_webp", found).get("source")
    image = {} if index is None else header["images"][index]
    uri = "" if image.get("uri", "").startswith("data:") else image.get("uri", "")
    label = uri[:60] or image.get("mimeType") or "of an unknown kind"
    return Material(label, wrap=tuple(_WRAP.get(sampler.get(key, 0), "repeat") for key in ("wrapS", "wrapT")))


@functools.cache
def _register() -> None:
    trimesh.exchange.gltf.extensions.register_handler(EXTENSION, "primitive_preprocess")(_read_primitive)


def _read_primitive(context: dict[str, Any]) -> None:
    """Give a primitive its points as numbers, its linear colours and its texture coordinates, as attributes of its own."""
    primitive, arrays, data = context["primitive"], context["accessors"], context["data"]
    attributes = primitive["attributes"]

    def numbers(index: int) -> Floats:
        told, array = data["accessors"][str(index)], np.array(arrays[index])
        if (sparse := told.get("sparse")) is not None:
            where = sparse["indices"]
            places = stored(where, where["componentType"], sparse["count"])
            values = stored(sparse["values"], told["componentType"], sparse["count"] * array[0].size)
            array[places] = values.reshape(-1, *array.shape[1:])
        if told.get("normalized") and array.dtype.kind in "iu":
            return np.maximum(array / np.iinfo(_TYPES[told["componentType"]]).max, -1.0)
        return array.astype(float)

    def stored(at: Mapping[str, Any], kind: int, count: int) -> np.ndarray:
        return np.frombuffer(context["views"][at["bufferView"]], _TYPES[kind], count, at.get("byteOffset", 0))

    def keep(array: np.ndarray) -> int:
        arrays.append(array)
        return len(arrays) - 1

    before = dict(attributes)
    attributes.clear()
    points = numbers(before["POSITION"])
    attributes["POSITION"] = keep(points)
    if "COLOR_0" in before or data["factor"] is not None:
        colors = numbers(before["COLOR_0"])[:, :3] if "COLOR_0" in before else np.ones_like(points)
        attributes[COLOR] = keep(colors * (data["factor"] or (1.0, 1.0, 1.0))[:3])
    texture = data["texture"] or {}
    move = texture.get("extensions", {}).get("KHR_texture_transform", {})
    coordinates = f"TEXCOORD_{move.get('texCoord', texture.get('texCoord', 0))}"
    if texture and coordinates in before:
        cos, sin = np.cos(move.get("rotation", 0.0)), np.sin(move.get("rotation", 0.0))
        uv = numbers(before[coordinates])[:, :2] * move.get("scale", (1.0, 1.0))
        uv = uv @ np.array([[cos, -sin], [sin, cos]]) + move.get("offset", (0.0, 0.0))
        attributes[UV] = keep(uv * (1, -1) + (0, 1))
    row = np.arange(len(points))
    if "indices" in primitive:
        row = numbers(primitive["indices"]).astype(np.int64).reshape(-1)
    if primitive.get("mode") == 6:  # a fan, which trimesh passes over
        primitive["mode"] = 4
        row = np.column_stack([np.full(len(row) - 2, row[0]), row[1:-1], row[2:]]).reshape(-1)
    primitive["indices"] = keep(row)
