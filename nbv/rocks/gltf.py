"""glTF as trimesh reads it right: numbers as they are meant, texture coordinates where the picture lies, a tree of nodes.

trimesh reads the scene, the buffers, Draco and the pictures. It takes normalised numbers raw and passes over sparse
accessors, `KHR_texture_transform`, further sets of texture coordinates and colours beside a texture. So its file gets a
header of ours, whose primitives carry an extension that does this when they are read.
"""

from __future__ import annotations

import functools
import importlib.util
import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

from nbv.errors import UserError
from nbv.rocks.looks import COLOR, UV, Look, UnusableMesh
from nbv.safe_files import MIB, parse_json, require
from nbv.types import Floats

MAX_HEADER_BYTES = 64 * MIB
MAX_VALUES = 5_000_000
MAX_NODES = 20_000  # a few seconds
MAX_ELEMENTS = 200_000_000  # of all accessors, before memory is taken
_DRACO, _GLOSS = "KHR_draco_mesh_compression", "KHR_materials_pbrSpecularGlossiness"
OURS = "GATETUNE_as_meant"
_READ = {_DRACO, "KHR_texture_transform", "KHR_mesh_quantization", "EXT_texture_webp"}
_TYPES = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
_WRAP = {33071: "clamp", 33648: "mirror"}


def as_meant(content: bytes, source: str, notes: list[str]) -> tuple[bytes, dict[str, Look]]:
    """The file with a header that trimesh reads as glTF 2.0 means it, and what its materials look like.

    Raises
    ------
    UnusableMesh
        It is no glTF, or needs what is not read.
    UserError
        It is too large, or needs a decoder that is not installed.
    """
    binary = content[:4] == b"glTF"
    start, end = (20, 20 + int.from_bytes(content[12:16], "little")) if binary else (0, len(content))
    require(end - start, MAX_HEADER_BYTES, f"the size of the header of {source} in bytes")
    try:
        header = parse_json(content[start:end].decode("utf-8-sig"), source, MAX_VALUES)
        looks = _rewrite(header, source, notes)
    except (KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
        raise UnusableMesh(
            f"is no valid glTF 2.0 ({type(error).__name__}: {error}); export it again"
        ) from error
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    if not binary:
        return text, looks
    sizes = struct.pack("<II", 20 + len(text) + len(content) - end, len(text))
    return content[:8] + sizes + content[16:20] + text + content[end:], looks


def _rewrite(header: dict[str, Any], source: str, notes: list[str]) -> dict[str, Look]:
    needed = set(header.get("extensionsRequired", ()))
    used = needed | set(header.get("extensionsUsed", ()))
    others = {name for name in used - _READ if not name.startswith("KHR_materials_")}
    views = header.get("bufferViews", ())
    packed = sorted({name for view in views for name in view.get("extensions", ()) if "meshopt" in name})
    if packed:
        raise UnusableMesh(
            f"is compressed with {packed[0]}, which is not read; export it without compression"
        )
    if others & needed:
        raise UnusableMesh(
            f"needs the glTF extension {min(others & needed)}, which is not read; export it without"
        )
    if others:
        notes.append(f"glTF extensions that are not read: {', '.join(sorted(others))}")
    primitives = [p for mesh in header.get("meshes", ()) for p in mesh["primitives"]]
    if any(p.get("targets") for p in primitives) or header.get("skins"):
        notes.append("skins and morph targets are not read: the mesh is as it is stored")
    if any(_DRACO in p.get("extensions", ()) for p in primitives) and not importlib.util.find_spec("DracoPy"):
        raise UserError(
            f"{source} is compressed with Draco, whose decoder is an extra; install it: pip install 'gatetune[draco]'"
        )
    accessors = header.get("accessors", [])
    total = sum(int(a["count"]) * len(a["type"]) for a in accessors)  # len: 4 to 6, for 1 to 16 numbers
    require(total, MAX_ELEMENTS, f"the number of elements that {source} tells of")
    _check_tree(header, source)
    infos = header.get("materials", [])
    looks = {}
    for i, material in enumerate(infos):
        base = material.get("pbrMetallicRoughness", {})
        if (gloss := material.get("extensions", {}).get(_GLOSS)) is not None:
            base = {
                "baseColorTexture": gloss.get("diffuseTexture"),
                "baseColorFactor": gloss.get("diffuseFactor"),
            }
        texture = base.get("baseColorTexture")
        looks[str(i)] = _look(header, texture)
        if texture is None and material.get("emissiveTexture"):
            notes.append(
                f"not read: the picture of {material.get('name', f'material {i}')!r}, which only shines"
            )
        infos[i] = {"name": str(i), "pbrMetallicRoughness": {"baseColorTexture": texture} if texture else {}}
        infos[i]["extras"] = {"factor": base.get("baseColorFactor")}  # not by trimesh, which rounds it
    for p in primitives:
        material = infos[p["material"]] if "material" in p else {"extras": {}, "pbrMetallicRoughness": {}}
        indices = {*p["attributes"].values(), *([p["indices"]] if "indices" in p else [])}
        data = {
            "accessors": {str(i): accessors[i] for i in indices},
            "factor": material["extras"].get("factor"),
            "texture": material["pbrMetallicRoughness"].get("baseColorTexture"),
        }
        p["extensions"] = {k: v for k, v in p.get("extensions", {}).items() if k == _DRACO} | {OURS: data}
    _register()
    return looks


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


def _look(header: dict[str, Any], texture: Mapping[str, Any] | None) -> Look:
    if texture is None:
        return Look()
    found = header["textures"][texture["index"]]
    sampler = header["samplers"][found["sampler"]] if "sampler" in found else {}
    webp = found.get("extensions", {}).get("EXT_texture_webp", {})
    index = webp.get("source", found.get("source"))
    image = {} if index is None else header["images"][index]
    name = image.get("uri", "")[:60] if not image.get("uri", "").startswith("data:") else ""
    label = name or f"its picture ({image.get('mimeType') or 'of an unknown kind'})"
    return Look(
        label=label, wrap=tuple(_WRAP.get(sampler.get(key, 0), "repeat") for key in ("wrapS", "wrapT"))
    )


@functools.cache
def _register() -> None:
    from trimesh.exchange.gltf.extensions import register_handler  # noqa: PLC0415  half a second to load

    register_handler(OURS, "primitive_preprocess")(_as_meant_primitive)


def _as_meant_primitive(context: dict[str, Any]) -> None:
    """Give a primitive its points as numbers, its linear colours and its texture coordinates, as attributes of our own."""
    primitive, arrays, data = context["primitive"], context["accessors"], context["data"]
    attributes = primitive["attributes"]

    def numbers(index: int) -> Floats:
        told, array = data["accessors"][str(index)], np.array(arrays[index])
        if (sparse := told.get("sparse")) is not None:
            places, values = (
                np.frombuffer(
                    context["views"][sparse[key]["bufferView"]],
                    _TYPES[sparse[key].get("componentType", told["componentType"])],
                    sparse["count"] * (1 if key == "indices" else array.size // len(array)),
                    sparse[key].get("byteOffset", 0),
                )
                for key in ("indices", "values")
            )
            array[places] = values.reshape(-1, *array.shape[1:])
        if told.get("normalized") and array.dtype.kind in "iu":
            return np.maximum(array / np.iinfo(_TYPES[told["componentType"]]).max, -1.0)
        return array.astype(float)

    def give(name: str, array: np.ndarray) -> None:
        attributes[name] = len(arrays)
        arrays.append(array)

    before = dict(attributes)
    attributes.clear()
    points = numbers(before["POSITION"])
    give("POSITION", points)
    if "COLOR_0" in before or data["factor"] is not None:
        factor = np.array(data["factor"] or (1.0, 1.0, 1.0))[:3]
        give(
            COLOR,
            factor * (numbers(before["COLOR_0"])[:, :3] if "COLOR_0" in before else np.ones_like(points)),
        )
    if data["texture"] is not None:
        move = data["texture"].get("extensions", {}).get("KHR_texture_transform", {})
        coordinates = f"TEXCOORD_{move.get('texCoord', data['texture'].get('texCoord', 0))}"
        if coordinates in before:
            cos, sin = np.cos(move.get("rotation", 0.0)), np.sin(move.get("rotation", 0.0))
            uv = numbers(before[coordinates])[:, :2] * move.get("scale", (1.0, 1.0))
            uv = uv @ np.array([[cos, -sin], [sin, cos]]) + move.get("offset", (0.0, 0.0))
            give(UV, np.column_stack([uv[:, 0], 1.0 - uv[:, 1]]))
    if "indices" in primitive:
        primitive["indices"], index = len(arrays), primitive["indices"]
        arrays.append(numbers(index).astype(np.int64).reshape(-1))
    if primitive.get("mode") == 6:  # a fan, which trimesh passes over
        row = arrays[primitive["indices"]] if "indices" in primitive else np.arange(len(points))
        primitive["mode"], primitive["indices"] = 4, len(arrays)
        arrays.append(np.column_stack([np.full(len(row) - 2, row[0]), row[1:-1], row[2:]]).reshape(-1))
