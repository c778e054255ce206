"""What a glTF file has that trimesh passes over or misreads without a word: refused, or told where it is colour alone.

trimesh reads the scene, the buffers and the pictures.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from nbv.rocks.mesh import UnusableMesh
from nbv.safe_files import MIB, parse_json, require

MAX_HEADER_BYTES = 64 * MIB
MAX_VALUES = 5_000_000
MAX_NODES = 20_000  # a few seconds
MAX_ELEMENTS = 200_000_000  # of all accessors, before memory is taken
_FAN, _REPEAT, _FLOAT, _BYTE = 6, 10497, 5126, 5121
_MOVED, _GLOSS = "KHR_texture_transform", "KHR_materials_pbrSpecularGlossiness"
_READ = {_MOVED, "KHR_mesh_quantization", "EXT_texture_webp"}
_WITHOUT = "not read; export it plainly, as from Blender, or run gltfpack -noq -i IN.glb -o OUT.glb"


def checked_gltf(content: bytes, source: str, notes: list[str]) -> tuple[str, int, bool]:
    """Why the colours of a ``.glb`` or ``.gltf`` file are not read ("": they are), its number of textures, and whether they repeat.

    ``notes`` gets what else is not read. Textures that do not repeat beyond 0 to 1 are clamped or mirrored there. `UnusableMesh`
    where it is no glTF, or its shape would be misread; `UserError` where it is too large.
    """
    start, end = 0, len(content)
    if content[:4] == b"glTF":
        start, end = 20, 20 + int.from_bytes(content[12:16], "little")
    require(end - start, MAX_HEADER_BYTES, f"the size of the header of {source} in bytes")
    try:
        header = parse_json(content[start:end].decode("utf-8-sig"), source, MAX_VALUES)
        primitives = [p for mesh in header.get("meshes", ()) for p in mesh["primitives"]]
        _check_shape(header, primitives, source, notes)
        materials = [header["materials"][p["material"]] for p in primitives if "material" in p]
        bases = [material.get("pbrMetallicRoughness", {}).get("baseColorTexture") for material in materials]
        textures = [texture for texture in bases if texture is not None]
        wraps = {s.get(key, _REPEAT) for s in header.get("samplers", ()) for key in ("wrapS", "wrapT")}
        return next(_unread_colors(header, primitives, textures), ""), len(textures), wraps <= {_REPEAT}
    except (KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
        raise UnusableMesh(
            f"is no valid glTF 2.0 ({type(error).__name__}: {error}); export it again"
        ) from error


def _check_shape(
    header: Mapping[str, Any], primitives: list[dict[str, Any]], source: str, notes: list[str]
) -> None:
    """Raise for what is very large, and where trimesh would misread what the mesh is shaped like."""
    needed, accessors = set(header.get("extensionsRequired", ())), header.get("accessors", ())
    packed = [view.get("extensions", ()) for view in header.get("bufferViews", ())]
    used = needed.union(header.get("extensionsUsed", ()), *packed)
    others = sorted(name for name in used - _READ if "materials" not in name)
    for name in others:
        if name in needed or "meshopt" in name or "draco" in name:
            raise UnusableMesh(f"needs the glTF extension {name}, which is {_WITHOUT}")
    if others:
        notes.append(f"glTF extensions that are not read: {', '.join(others)}")
    if any("sparse" in accessor for accessor in accessors):
        raise UnusableMesh(f"has sparse accessors, which are {_WITHOUT}")
    if any(accessors[p["attributes"]["POSITION"]].get("normalized") for p in primitives):
        raise UnusableMesh(f"has normalized positions, which are {_WITHOUT}")
    if any(p.get("mode") == _FAN for p in primitives):
        raise UnusableMesh("has fans of triangles, which are not read; export single triangles")
    if any(p.get("targets") for p in primitives) or header.get("skins"):
        notes.append("skins and morph targets are not read: the mesh is as it is stored")
    total = sum(int(a["count"]) * len(a["type"]) for a in accessors)  # len: 4 to 6, for 1 to 16 numbers
    require(total, MAX_ELEMENTS, f"the number of elements that {source} tells of")
    nodes, scenes = header.get("nodes", ()), header.get("scenes", ())
    require(len(nodes), MAX_NODES, f"the number of nodes in {source}")
    seen = [child for node in nodes for child in node.get("children", ())]
    seen += scenes[header.get("scene", 0)].get("nodes", ()) if scenes else ()
    if len(set(seen)) < len(seen):
        raise UnusableMesh("has a node twice in its scene or in a circle; export it again")
    if any("camera" in node and ("mesh" in node or node.get("children")) for node in nodes):
        raise UnusableMesh(
            "has meshes that hang from a camera, which are not read; export it without cameras"
        )


def _unread_colors(
    header: Mapping[str, Any], primitives: list[dict[str, Any]], textures: list[dict[str, Any]]
) -> Iterator[str]:
    """Reasons why colours are not as the file means them, with remedies."""
    if any(_GLOSS in material.get("extensions", ()) for material in header.get("materials", ())):
        yield f"{_GLOSS}: gltf-transform metalrough IN.glb OUT.glb"
    if any(_MOVED in texture.get("extensions", ()) for texture in textures):
        yield f"{_MOVED}: apply it to the texture coordinates before you export"
    if any(texture.get("texCoord") for texture in textures):
        yield "a second set of texture coordinates: export with one"
    for p in primitives:
        kinds = {name: header["accessors"][i]["componentType"] for name, i in p["attributes"].items()}
        if textures and kinds.get("TEXCOORD_0", _FLOAT) != _FLOAT:
            yield "texture coordinates in whole numbers: gltf-transform dequantize IN.glb OUT.glb"
        if "material" not in p and kinds.get("COLOR_0", _FLOAT) not in (_FLOAT, _BYTE):
            yield "COLOR_0 in whole numbers: gltf-transform dequantize IN.glb OUT.glb"
