"""A mesh file, read: its triangles in one list, with the colours that they carry.

Open3D's assimp reads what has materials, OBJ and glTF, and splits polygons of any shape. trimesh reads what has none, PLY, STL and OFF:
Open3D's own readers of these end the process where a polygon names a vertex beyond the end.
"""

from __future__ import annotations

import io
import logging
import re
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import lazy_loader
import numpy as np
from PIL import Image

from nbv.geometry.mesh import drop_unused_vertices
from nbv.rocks.texture import Linear, linear_from_srgb, linear_image
from nbv.safe_files import MIB, is_file, parse_json, read_bytes, require
from nbv.types import Floats, Ints

MAX_COORDINATE = 1e9  # a map's in millimetres are below
MAX_FACES = 5_000_000
MAX_FILE_BYTES = 2 * 1024**3
MAX_TOLD = 3  # files that are missing, by name
MAX_HEADER_BYTES = 64 * MIB  # of glTF
GLTF = (".glb", ".gltf")
trimesh: Any = lazy_loader.load("trimesh")  # half a second, and most commands read no mesh
_WITH_MATERIALS, _WITHOUT = (*GLTF, ".obj"), (".ply", ".stl", ".off")
_PACKED = (".gz", ".bz2", ".xz", ".tar", ".tgz", ".7z", ".zip")
_FLOAT, _REPEAT, _MOVED = 5126, 10497, "KHR_texture_transform"  # of glTF
_PLAINLY, _UNPACK = (
    "export it plainly, as from Blender",
    "unpack it: npx @gltf-transform/cli dequantize IN.glb OUT.glb",
)
# What changes shape or colours wherever a file uses it, and what helps.
_UNREAD = {
    "KHR_draco_mesh_compression": _UNPACK,
    "EXT_meshopt_compression": _UNPACK,
    "KHR_materials_pbrSpecularGlossiness": "convert it: npx @gltf-transform/cli metalrough IN.glb OUT.glb",
}
_READ = {_MOVED, "KHR_mesh_quantization", "EXT_texture_webp", "KHR_texture_basisu"}  # or seen from the result


class UnusableMesh(Exception):
    """Why a mesh file is no rock: what reads on after "mesh file NAME"."""


@dataclass(frozen=True)
class FileMesh:
    """Triangles of a whole file, with their vertices' attributes; a vertex is there once for each of its colours."""

    values: Floats  # (V, 9): x, y, z; a linear colour, or NaN; texture coordinates u, v; index of the texture, or -1
    faces: Ints  # (F, 3)
    textures: list[Linear]
    step: float  # the coarsest, between neighbouring values of a coordinate, in the file's unit; 0 where there is none


def read_mesh_file(path: Path, notes: list[str]) -> FileMesh:
    """All triangles of the file; ``notes`` gets what is out of the ordinary, and what was not read.

    `UnusableMesh` where the file is unreadable, empty, without faces, not finite, far too large, or has what is not read here;
    `UserError` for a texture that is far too large.
    """
    size, kind = path.stat().st_size, path.suffix.lower()
    if size == 0:
        raise UnusableMesh("is empty")
    if size > MAX_FILE_BYTES:
        raise UnusableMesh(f"has {size / 1e9:.1f} GB; decimate it first")
    if kind not in (*_WITH_MATERIALS, *_WITHOUT, *_PACKED):
        raise UnusableMesh("is not of a format that is read; export the mesh as GLB, OBJ, PLY, STL or OFF")
    if kind in _PACKED or zipfile.is_zipfile(path):
        raise UnusableMesh("is packed; unpack it, or export the mesh as GLB, OBJ, PLY or STL")
    values, faces, textures = (_with_materials if kind in _WITH_MATERIALS else _without)(path, kind, notes)
    if not len(faces):
        raise UnusableMesh(
            "holds no faces that can be read: none at all, or some name vertices that it does not hold; export a mesh again, not "
            "points or lines, as from Blender or MeshLab"
        )
    if len(faces) > MAX_FACES:
        raise UnusableMesh(
            f"has {len(faces) / 1e6:.1f} million faces; decimate it to {MAX_FACES / 1e6:g} million or fewer"
        )
    if faces.min() < 0 or faces.max() >= len(values):
        raise UnusableMesh("has faces that name vertices it does not hold; export it again")
    values, faces = drop_unused_vertices(values, faces)
    bad = ~np.isfinite(values[:, :3]).all(axis=1)
    if bad.any():
        raise UnusableMesh(f"has {bad.sum()} vertices that are not finite numbers; repair or re-export it")
    reach = float(np.abs(values[:, :3]).max())
    if reach > MAX_COORDINATE:
        raise UnusableMesh(
            f"has a coordinate of {reach:.3g}; the limit is {MAX_COORDINATE:g}, export it again"
        )
    return FileMesh(values, faces, textures, coarsest_step(values[:, :3]))


def coarsest_step(points: Floats) -> float:
    """The coarsest step between values of one coordinate: that of single precision, or of a regular grid on which they lie.

    A grid counts only with 100 vertices or more, and four times as many as it has values. 0 where there is neither.
    """
    steps = [0.0]
    for column in points.T:
        values = np.unique(column)
        gaps = np.diff(values)
        if (values.astype(np.float32) == values).all():
            steps.append(float(np.spacing(np.float32(np.abs(values).max()))))
        if len(points) >= max(100, 4 * len(values)) and len(gaps) > 1:
            counts = gaps / gaps.min()
            if np.abs(counts - np.rint(counts)).max() < 1e-3:
                steps.append(float(gaps.min()))
    return max(steps)


def side_files(path: Path) -> list[str]:
    """The files that a mesh file names: materials and textures of OBJ, buffers and textures of glTF."""
    kind = path.suffix.lower()
    if kind == ".gltf":
        names = re.findall(rb'"uri"\s*:\s*"(?!data:)([^"]+)"', read_bytes(path, MAX_FILE_BYTES))
        return [unquote(name.decode(errors="replace")) for name in names]
    libraries = _words_after(rb"mtllib", path) if kind == ".obj" else []
    return libraries + [name for library in libraries for name in _textures_of(path.parent / library)]


def _textures_of(library: Path) -> list[str]:
    """The textures that an MTL file names, with their options."""
    return _words_after(rb"map_K[ades]", library) if is_file(library) else []


def _words_after(keyword: bytes, path: Path) -> list[str]:
    lines = re.findall(rb"^[ \t]*" + keyword + rb"[ \t]+(.*\S)", read_bytes(path, MAX_FILE_BYTES), re.M)
    return [line.decode(errors="replace").replace("\\", "/") for line in lines]


def _with_materials(path: Path, kind: str, notes: list[str]) -> tuple[Floats, Ints, list[Linear]]:
    """Values (V, 9), faces and textures of an OBJ or glTF file."""
    import open3d as o3d  # noqa: PLC0415  seconds to load

    named, repeats = _check_obj(path) if kind == ".obj" else _check_gltf(path, notes)
    with o3d.utility.VerbosityContextManager(
        o3d.utility.VerbosityLevel.Error
    ):  # its warnings would be a second message
        model = o3d.io.read_triangle_model(str(path))  # type: ignore[arg-type]  # a wrong stub
    missing = [name for name in dict.fromkeys(side_files(path)) if not is_file(path.parent / name)]
    notes += [f"not read: {name!r}, which is not beside the mesh" for name in missing[:MAX_TOLD]]
    if missing and not model.meshes:
        raise UnusableMesh(f"needs {missing[0]!r}, which is not beside it; put it there")
    textures: list[Linear] = []
    texture_of = [_texture(material, textures, notes) for material in model.materials]
    values, faces, used, offset = [np.zeros((0, 9))], [np.zeros((0, 3), dtype=np.int64)], set(), 0
    for part in model.meshes:
        mesh, base = part.mesh, np.asarray(model.materials[part.material_idx].base_color[:3])
        points, corners = np.asarray(mesh.vertices), np.asarray(mesh.triangles, dtype=np.int64)
        texture, uv = texture_of[part.material_idx], np.zeros((len(points), 2))
        if mesh.has_triangle_uvs():
            uv[corners.reshape(-1)] = np.asarray(mesh.triangle_uvs)
        else:
            texture = -1
        if texture >= 0 and not repeats and np.abs(uv - 0.5).max(initial=0) > 0.51:
            raise UnusableMesh(
                "has a texture that is clamped or mirrored; export it with coordinates from 0 to 1"
            )
        colors = np.tile(base, (len(points), 1))
        if mesh.has_vertex_colors():
            own = np.asarray(mesh.vertex_colors)
            colors = own * base if kind in GLTF else own
        if colors.max(initial=0) > 1.001:
            raise UnusableMesh("has colours of vertices beyond 1; export them from 0 to 1")
        if kind == ".obj":
            colors = np.ones_like(colors) if texture >= 0 else linear_from_srgb(colors)
        values.append(np.column_stack([points, colors, uv, np.full(len(points), texture)]))
        faces.append(corners + offset)
        used.add(texture)
        offset += len(points)
    if len(used - {-1}) < named and not missing:
        notes.append(
            "not read: a texture, which no face uses, or of a format that is not read; PNG and JPEG are"
        )
    return np.concatenate(values), np.concatenate(faces), textures


def _texture(material: Any, textures: list[Linear], notes: list[str]) -> int:
    """Index of the material's texture among ``textures``, to which it is added; -1 where it has none."""
    if material.albedo_img is None:
        return -1
    try:
        textures.append(linear_image(Image.fromarray(np.asarray(material.albedo_img).squeeze())))
    except (TypeError, ValueError):
        notes.append("not read: a texture that has not 8 bits a channel")
        return -1
    return len(textures) - 1


def _check_obj(path: Path) -> tuple[int, bool]:
    """Whether the file names a texture (1 or 0), and that textures repeat; `UnusableMesh` for what assimp would misread."""
    content = read_bytes(path, MAX_FILE_BYTES)
    if re.search(rb"[\r\n][ \t]+[vf][ \t]", content):
        raise UnusableMesh("has indented lines, which are not read; export it again, or take the spaces away")
    if re.search(rb"^f.*[ \t]0+(?:[ \t\r/]|$)", content, re.M):
        raise UnusableMesh("counts vertices from 0, where OBJ begins with 1; export it again")
    textures = [
        name for library in _words_after(rb"mtllib", path) for name in _textures_of(path.parent / library)
    ]
    for name in textures:
        if name.startswith("-"):
            raise UnusableMesh(
                f"has a texture with options ({name[:40]}), which are not read; take them out of the MTL file"
            )
    return min(len(textures), 1), True


def _check_gltf(path: Path, notes: list[str]) -> tuple[int, bool]:
    """How many materials have a texture, and whether all textures repeat; `UnusableMesh` for what assimp would misread."""
    content = read_bytes(path, MAX_FILE_BYTES)
    start, end = 0, len(content)
    if content[:4] == b"glTF":
        start, end = 20, 20 + int.from_bytes(content[12:16], "little")
    require(end - start, MAX_HEADER_BYTES, f"the size of the header of {path} in bytes")
    try:
        header = parse_json(content[start:end].decode("utf-8-sig"), str(path))
        if not header.get("scenes"):
            raise UnusableMesh("has no scene, so that nothing in it is shown; export it again")
        needed = set(header.get("extensionsRequired", ()))
        others = needed.union(header.get("extensionsUsed", ())) - _READ
        others = {name for name in others if "materials" not in name or name in _UNREAD}
        for name in sorted(others & (needed | set(_UNREAD))):
            raise UnusableMesh(
                f"needs the glTF extension {name}, which is not read; {_UNREAD.get(name, _PLAINLY)}"
            )
        if others:
            notes.append(f"glTF extensions that are not read: {', '.join(sorted(others))}")
        primitives = [p for mesh in header.get("meshes", ()) for p in mesh["primitives"]]
        for attributes in (p["attributes"] for p in primitives):
            for name in {"POSITION", "TEXCOORD_0"} & set(attributes):
                if header["accessors"][attributes[name]]["componentType"] != _FLOAT:
                    raise UnusableMesh(f"holds {name} in whole numbers, which are not read; {_UNPACK}")
        if header.get("skins") or any(p.get("targets") for p in primitives):
            notes.append("skins and morph targets are not read: the mesh is as it is stored")
        used = {p["material"] for p in primitives if "material" in p}
        bases = [header["materials"][m].get("pbrMetallicRoughness", {}).get("baseColorTexture") for m in used]
        textures = [texture for texture in bases if texture is not None]
        for texture in textures:
            moved = texture.get("extensions", {}).get(_MOVED, {})
            if texture.get("texCoord") or any(
                moved.get(key, plain) != plain
                for key, plain in (("offset", [0, 0]), ("scale", [1, 1]), ("rotation", 0), ("texCoord", 0))
            ):
                raise UnusableMesh(
                    f"moves its texture, or has a second set of coordinates for it, which is not read; {_PLAINLY}"
                )
        wraps = {s.get(key, _REPEAT) for s in header.get("samplers", ()) for key in ("wrapS", "wrapT")}
        return len(textures), wraps <= {_REPEAT}
    except (KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
        raise UnusableMesh("is no valid glTF 2.0; export it again") from error


def _without(path: Path, kind: str, notes: list[str]) -> tuple[Floats, Ints, list[Linear]]:
    """Values (V, 9), faces and no textures of a PLY, STL or OFF file."""
    content = read_bytes(path, MAX_FILE_BYTES)
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # its warnings would be a second message
    try:
        # In PLY files `fix_texture` would part vertices from their colours.
        options = {"fix_texture": False, "skip_materials": True} if kind == ".ply" else {}
        mesh = trimesh.load_mesh(io.BytesIO(content), file_type=kind[1:], process=False, **options)
    except Exception as error:  # loaders raise whatever their parsers do
        if re.search(rb"\s-?\d+,\d+\s", content[:100_000]):
            raise UnusableMesh("has decimal commas; export it with decimal points") from error
        raise UnusableMesh(
            "cannot be read: it is damaged or cut off, or has faces of more than three corners; export triangles, as from "
            "Blender or MeshLab"
        ) from error
    points, faces = np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces, dtype=np.int64)
    elements = mesh.metadata.get("_ply_raw", {})
    told = re.match(rb"\s*[A-Z]*OFF\s+(?:#.*\s+)*\d+\s+(\d+)", content) if kind == ".off" else None
    count = int(told[1]) if told else elements.get("face", {}).get("length", len(faces))
    if len(faces) and count != len(faces):
        raise UnusableMesh(
            "has faces of more than three corners, which are read in OBJ files only; export triangles"
        )
    colors = np.full((len(points), 3), np.nan)
    if re.search(rb"^comment[ \t]+TextureFile", content[: content.find(b"end_header")], re.M | re.I):
        notes.append("not read: a texture of a PLY file; export it as GLB or OBJ")
    elif (own := _ply_colors(elements.get("vertex", {}), notes)) is not None:
        colors = own
    elif len(faces) and (own := _ply_colors(elements.get("face", {}), notes)) is not None:
        colors, points, faces = (
            np.repeat(own, 3, axis=0),
            points[faces].reshape(-1, 3),
            np.arange(faces.size).reshape(-1, 3),
        )
    return np.column_stack([points, colors, np.zeros((len(points), 2)), np.full(len(points), -1)]), faces, []


def _ply_colors(element: dict[str, Any], notes: list[str]) -> Floats | None:
    """(N, 3) linear colours of a PLY file's vertices or faces; None where it has none that are read."""
    names = [
        name for name in element.get("properties", ()) if re.fullmatch("(diffuse_)?(red|green|blue)", name)
    ]
    if len(names) != 3:
        return None
    raw = np.column_stack([np.asarray(element["data"][name]) for name in names])
    kinds = {element["properties"][name].lstrip("<>|") for name in names}
    top = {"u1": 255.0, "u2": 65535.0}.get(kinds.pop(), 1.0)
    if kinds or not (raw >= 0).all() or raw.max(initial=0) > top:
        notes.append("not read: colours of a PLY file; save them as uchar red, green and blue")
        return None
    return linear_from_srgb(raw / top)
