"""What a glTF file has that trimesh passes over or misreads without a word: refused, or told where it is colour alone.

trimesh reads the scene, the buffers and the pictures.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from nbv.rocks.errors import UnusableMesh
from nbv.rocks.gltf_numbers import MOVED, plain_gltf
from nbv.safe_files import MIB, parse_json, require

MAX_HEADER_BYTES = 64 * MIB
MAX_VALUES = 5_000_000
MAX_NODES = 20_000  # a few seconds
MAX_ELEMENTS = 200_000_000  # of all accessors, before memory is taken
_FAN, _REPEAT = 6, 10497
_GLOSS, _KTX2 = "KHR_materials_pbrSpecularGlossiness", "KHR_texture_basisu"
_READ = {MOVED, "KHR_mesh_quantization", "EXT_texture_webp", _KTX2}


def checked_gltf(
    content: bytes, source: str, notes: list[str], read: Callable[[str], bytes]
) -> tuple[bytes, str, int, bool]:
    """A ``.glb`` or ``.gltf`` file as trimesh reads it rightly, why its colours are not read ("": they are), its number of textures,
    and whether they repeat. ``read`` gives the content of a file that it names.

    ``notes`` gets what else is not read. Textures that do not repeat beyond 0 to 1 are clamped or mirrored there. `UnusableMesh`
    where it is no glTF, or its shape would be misread; `UserError` where it is too large.
    """
    start, end = 0, len(content)
    if content[:4] == b"glTF":
        start, end = 20, 20 + int.from_bytes(content[12:16], "little")
    require(end - start, MAX_HEADER_BYTES, f"the size of the header of {source} in bytes")
    try:
        header = parse_json(content[start:end].decode("utf-8-sig"), source)
        primitives = [p for mesh in header.get("meshes", ()) for p in mesh["primitives"]]
        _check_shape(header, primitives, source, notes)
        materials = [header["materials"][p["material"]] for p in primitives if "material" in p]
        bases = [material.get("pbrMetallicRoughness", {}).get("baseColorTexture") for material in materials]
        textures = [texture for texture in bases if texture is not None]
        wraps = {s.get(key, _REPEAT) for s in header.get("samplers", ()) for key in ("wrapS", "wrapT")}
        plain = plain_gltf(content, header, read)
        return plain, _unread_colors(header), len(textures), wraps <= {_REPEAT}
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
            raise UnusableMesh(f"needs the glTF extension {name}, which is not read; {_plainly(name)}")
    if others:
        notes.append(f"glTF extensions that are not read: {', '.join(others)}")
    if any("sparse" in accessors[p["indices"]] for p in primitives if "indices" in p):
        raise UnusableMesh(
            "has sparse indices of faces, which are not read; export it plainly, as from Blender"
        )
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


def _unread_colors(header: Mapping[str, Any]) -> str:
    """Why colours are not as the file means them, with the remedy; "" where they are."""
    if any(_GLOSS in material.get("extensions", ()) for material in header.get("materials", ())):
        return f"{_GLOSS}: npx @gltf-transform/cli metalrough IN.glb OUT.glb"
    if any(_KTX2 in t.get("extensions", ()) and "source" not in t for t in header.get("textures", ())):
        return f"{_KTX2}: export it with PNG or JPEG textures"
    return ""


def _plainly(extension: str) -> str:
    """How to do without an extension: commands that were run on files that need it."""
    if "draco" in extension or "meshopt" in extension:
        return "unpack it: npx @gltf-transform/cli dequantize IN.glb OUT.glb"
    return "export it plainly, as from Blender"
