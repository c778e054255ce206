"""A mesh file, read: its triangles in one list, with the colours that they carry."""

from __future__ import annotations

import io
import re
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import lazy_loader
import numpy as np
from PIL import Image, UnidentifiedImageError

from nbv.errors import UserError
from nbv.geometry.mesh import drop_unused_vertices
from nbv.rocks.errors import UnusableMesh
from nbv.rocks.gltf import checked_gltf
from nbv.rocks.texture import Linear, linear_from_srgb, linear_image
from nbv.safe_files import read_bytes, require
from nbv.types import Floats, Ints

MAX_COORDINATE = 1e9  # a map's in millimetres are below
MAX_FACES = 5_000_000
MAX_FILE_BYTES = 2 * 1024**3
MAX_SIDE_FILE_BYTES = 1024**3  # materials, textures and buffers, each
MAX_MATERIALS = 1_000
MAX_TOLD = 3  # files that are not read, by name
GLTF = (".glb", ".gltf")
trimesh: Any = lazy_loader.load("trimesh")  # half a second, and most commands read no mesh
_READ = (*GLTF, ".obj", ".ply", ".stl", ".off")
_PACKED = (".gz", ".bz2", ".xz", ".tar", ".tgz", ".7z")


@dataclass(frozen=True)
class FileMesh:
    """Triangles of a whole file, with their vertices' attributes; a vertex is there once for each of its colours."""

    values: Floats  # (V, 9): x, y, z; a linear colour, or NaN; texture coordinates u, v; index of the texture, or -1
    faces: Ints  # (F, 3)
    textures: list[Linear]
    step: float  # the coarsest, between neighbouring values of a coordinate, in the file's unit; 0 where there is none


def read_mesh_file(path: Path, notes: list[str], side_files: list[str]) -> FileMesh:
    """All triangles of the file's scene; ``notes`` gets what is out of the ordinary, and what was not read.

    ``side_files`` gets the names of the files beside it that it names (materials, textures, buffers), also of missing ones.

    `UnusableMesh` where the file is unreadable, empty, without faces, not finite or far too large; `UserError` for an archive or a
    texture that is far too large.
    """
    size = path.stat().st_size
    if size == 0:
        raise UnusableMesh("is empty")
    if size > MAX_FILE_BYTES:
        raise UnusableMesh(f"has {size / 1e9:.1f} GB; decimate it first")
    if path.suffix.lower() not in (*_READ, *_PACKED, ".zip"):
        raise UnusableMesh("is not of a format that is read; export the mesh as GLB, OBJ, PLY, STL or OFF")
    if path.suffix.lower() in _PACKED or zipfile.is_zipfile(path):
        raise UnusableMesh("is packed; unpack it, or export the mesh as GLB, OBJ, PLY or STL")
    scene, colors = _load(path, notes, side_files)
    placed = [
        (scene.geometry[name], transform)
        for transform, name in map(scene.graph.get, scene.graph.nodes_geometry)
    ]
    parts = [(part, at) for part, at in placed if isinstance(part, trimesh.Trimesh) and len(part.faces)]
    if not parts:
        raise UnusableMesh("holds no faces in its scene; export a triangle mesh, not points or lines")
    if left_out := len(scene.geometry) - len({id(part) for part, _ in placed}):
        notes.append(f"{left_out} meshes are not read, which have no place in the file's scene")
    count = sum(len(part.faces) for part, _ in parts)
    if count > MAX_FACES:
        raise UnusableMesh(
            f"has {count / 1e6:.1f} million faces; decimate it to {MAX_FACES / 1e6:g} million or fewer"
        )
    values, faces = [], []
    offset, step = 0, 0.0
    for part, transform in parts:
        corners, points = np.asarray(part.faces, dtype=np.int64), np.asarray(part.vertices, dtype=float)
        if points.ndim != 2 or points.shape[1] != 3 or corners.min() < 0 or corners.max() >= len(points):
            raise UnusableMesh("has faces that name vertices it does not hold; export it again")
        if part.visual.kind == "face":
            part.unmerge_vertices()
            corners, points = part.faces, np.asarray(part.vertices, dtype=float)
        determinant = float(np.linalg.det(transform[:3, :3]))
        step = max(step, coarsest_step(points) * abs(determinant) ** (1 / 3))
        points = points @ transform[:3, :3].T + transform[:3, 3]
        if determinant < 0:  # a mirroring node turns faces inside out
            corners = corners[:, ::-1]
        values.append(np.hstack([points, colors.of_vertices(part)]))
        faces.append(corners + offset)
        offset += len(points)
    if len(parts) > 1:
        notes.append(f"joined {len(parts)} meshes of the file's scene")
    whole = drop_unused_vertices(np.concatenate(values), np.concatenate(faces))
    mesh = FileMesh(*whole, colors.textures, step)
    bad = ~np.isfinite(mesh.values[:, :3]).all(axis=1)
    if bad.any():
        raise UnusableMesh(f"has {bad.sum()} vertices that are not finite numbers; repair or re-export it")
    reach = float(np.abs(mesh.values[:, :3]).max())
    if reach > MAX_COORDINATE:
        raise UnusableMesh(
            f"has a coordinate of {reach:.3g}; the limit is {MAX_COORDINATE:g}, export it again"
        )
    notes[:] = dict.fromkeys(notes)
    return mesh


def coarsest_step(points: Floats) -> float:
    """The coarsest step between values of one coordinate: that of single precision, or of a regular grid on which they lie.

    A grid counts only with 100 vertices or more, and four times as many as it has values. 0 where there is neither.
    """
    steps = [0.0]
    for column in points.T[:, (np.abs(points) <= MAX_COORDINATE).all(axis=1)]:
        values = np.unique(column)
        gaps = np.diff(values)
        if len(values) and (values.astype(np.float32) == values).all():
            steps.append(float(np.spacing(np.float32(np.abs(values).max()))))
        if len(points) >= max(100, 4 * len(values)) and len(gaps) > 1:
            counts = gaps / gaps.min()
            if np.abs(counts - np.rint(counts)).max() < 1e-3:
                steps.append(float(gaps.min()))
    return max(steps)


def _load(path: Path, notes: list[str], side_files: list[str]) -> tuple[Any, _Colors]:
    """The file's scene as trimesh reads it, and what reads the colours of its parts."""
    kind, content = path.suffix.lower(), path.read_bytes()
    files = _SideFiles(path.parent, side_files, pictures=kind not in GLTF)
    unread, textures, repeats = "", 0, True
    if kind in GLTF:
        content, unread, textures, repeats = checked_gltf(content, str(path), notes, files.get)
    elif kind == ".obj":
        content = _readable_obj(content, notes)
    elif kind == ".ply":
        unread = _unread_in_ply(content)
    try:
        # In PLY files `fix_texture` would part vertices from their colours.
        options = {"fix_texture": False, "skip_materials": True} if kind == ".ply" else {}
        scene = trimesh.load_scene(
            io.BytesIO(content), file_type=kind[1:], process=False, resolver=files, **options
        )
    except Exception as error:  # loaders raise whatever their parsers do
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        raise UnusableMesh(f"cannot be read: {reason}") from error
    parts = [part for part in scene.geometry.values() if isinstance(part, trimesh.Trimesh)]
    plain = [part for part in parts if _picture(part) is None]
    if len(parts) - len(plain) < textures and not unread:
        unread = "a texture is missing, or of a format that is not read"
    if (
        kind == ".obj"
        and b"mtllib" in content
        and not files.missing
        and any(_plain_colors(part) is None for part in plain)
    ):
        files.missing.append("materials: faces name none (usemtl), or one that the MTL file does not have")
    notes += [f"not read: {name}" for name in files.missing[:MAX_TOLD]]
    return scene, _Colors(notes, unread, linear=kind in GLTF, repeats=repeats)


def _readable_obj(content: bytes, notes: list[str]) -> bytes:
    """An OBJ file without what trimesh misreads: tabs about materials, and colours of vertices beyond 1."""
    content = re.sub(rb"^[ \t]*usemtl[ \t]+", b"usemtl ", content, flags=re.M)
    named = len(set(re.findall(rb"^usemtl.*$", content, re.M)))
    require(named, MAX_MATERIALS, "the number of materials that the OBJ file's faces name")
    if re.search(rb"^v([ \t]+\S+){3}.*[ \t]([2-9]|\d\d+)(\.\d*)?(?=\s)", content, re.M):
        notes.append("not read: colours of vertices, which go beyond 1; export them from 0 to 1")
        content = re.sub(rb"^(v(?:[ \t]+\S+){3}).*$", rb"\1", content, flags=re.M)
    return content


def _unread_in_ply(content: bytes) -> str:
    """Why trimesh does not read a PLY file's colours as they are meant; "" where it does."""
    header = content[: content.find(b"end_header")]
    if re.search(rb"^comment[ \t]+TextureFile", header, re.M | re.I):
        return "a texture of a PLY file: export it as GLB or OBJ"
    for kind, name in re.findall(rb"^property[ \t]+(\S+)[ \t]+((?:diffuse_)?red)[ \t\r]*$", header, re.M):
        if kind not in (b"uchar", b"uint8") or name != b"red":
            return f"{kind.decode()} {name.decode()}: save them as uchar red, green and blue"
    return ""


class _SideFiles:
    """Where trimesh finds what the mesh names: regular files of a size, in the mesh's folder or below."""

    def __init__(self, folder: Path, side_files: list[str], *, pictures: bool) -> None:
        self.folder, self._side_files = folder.resolve(), side_files
        self.missing: list[str] = []  # what could not be read, and why
        self._pictures = pictures  # whether what is no MTL file must be a picture

    def get(self, name: str) -> bytes:
        """The content of a file; raises where there is none that may be read, or no picture."""
        self._side_files.append(name)
        try:
            content = read_side_file(self.folder, name)
            if name.lower().endswith(".mtl"):
                others = sorted({word.decode() for word in re.findall(rb"^\s*(map_K[aes])\s", content, re.M)})
                if others and b"map_Kd" not in content:
                    self.missing.append(f"{name!r} (its textures are {', '.join(others)}; call them map_Kd)")
                require(content.count(b"newmtl"), MAX_MATERIALS, f"the number of materials in {name}")
            elif self._pictures:
                Image.open(io.BytesIO(content))
        except Exception as error:  # what Pillow raises depends on the file
            reason = "no picture" if isinstance(error, UnidentifiedImageError) else str(error)[:100]
            self.missing.append(f"{name!r} ({reason})")
            raise
        return content

    __getitem__ = get


def read_side_file(folder: Path, name: str) -> bytes:
    """What the mesh file calls ``name``; `UserError` unless it is a regular file of a size in its folder or below."""
    path = folder / unquote(name.strip()).replace("\\", "/")
    if not path.resolve().is_relative_to(folder):
        raise UserError(f"{name} is not in the mesh's folder")
    return read_bytes(path, MAX_SIDE_FILE_BYTES)


class _Colors:
    """Reads colours and texture coordinates of vertices, part by part of a scene.

    ``unread`` says why the file's colours are not read, if so; they are ``linear`` or sRGB, and textures repeat or not beyond 0 to 1.
    """

    def __init__(
        self, notes: list[str], unread: str = "", *, linear: bool = False, repeats: bool = True
    ) -> None:
        self.textures: list[Linear] = []
        self._notes, self._unread, self._linear, self._repeats = notes, unread, linear, repeats
        self._opened: dict[int, int] = {}  # index of a texture by the identity of its picture
        if unread:
            notes.append(f"not read: colours and textures ({unread})")

    def of_vertices(self, part: Any) -> Floats:
        """(V, 6) a linear colour or NaN, u, v, index of the texture or -1."""
        colors, picture = np.full((len(part.vertices), 3), np.nan), None if self._unread else _picture(part)
        plain = None if self._unread else _plain_colors(part)
        if self._linear and plain is not None:
            colors[:] = plain
        elif plain is not None and picture is None:
            colors[:] = linear_from_srgb(plain.astype(np.float32))
        uv: Any = getattr(part.visual, "uv", None)
        texture = -1
        if picture is not None and (uv is None or len(uv) != len(colors) or not np.isfinite(uv).all()):
            self._notes.append("not read: a texture; the mesh has no coordinates for it")
        elif picture is not None and not self._repeats and np.abs(uv - 0.5).max() > 0.51:
            self._notes.append(
                "not read: a texture that is clamped or mirrored; export it with coordinates from 0 to 1"
            )
        elif picture is not None:
            texture = self._texture(picture)
        if texture < 0:
            return np.column_stack([colors, np.zeros((len(colors), 2)), np.full(len(colors), -1)])
        return np.column_stack([np.where(np.isnan(colors), 1.0, colors), uv, np.full(len(colors), texture)])

    def _texture(self, picture: Any) -> int:
        """Index of the picture among `textures`; -1 and a note where it cannot be read."""
        if id(picture) not in self._opened:
            self._opened[id(picture)] = -1
            try:
                self.textures.append(linear_image(picture))
                self._opened[id(picture)] = len(self.textures) - 1
            except (OSError, ValueError, SyntaxError) as error:
                self._notes.append(f"not read: a texture ({' '.join(str(error).split())[:80]})")
        return self._opened[id(picture)]


def _picture(part: Any) -> Any:
    """The texture of a part of a scene, as Pillow's; None where it has none."""
    material = getattr(part.visual, "material", None)
    picture = getattr(material, "image", None) or getattr(material, "baseColorTexture", None)
    return picture if getattr(picture, "format", None) else None  # trimesh makes some up


def _plain_colors(part: Any) -> Floats | None:
    """Colours of vertices (V, 3), of the material (3,), or in glTF their product; None where there are none."""
    kind, material = part.visual.kind, getattr(part.visual, "material", None)
    if kind in ("vertex", "face"):
        colors = _shares(getattr(part.visual, f"{kind}_colors"))
        return np.repeat(colors, 3, axis=0) if kind == "face" else colors  # no two faces share a vertex
    raw = getattr(part.visual, "vertex_attributes", {}).get("color", part.vertex_attributes.get("color"))
    plain = None if raw is None else _shares(raw)
    if (factor := getattr(material, "baseColorFactor", None)) is not None:
        plain = _shares(factor) * (1.0 if plain is None else plain)
    kd: Any = getattr(material, "kwargs", {}).get("kd")  # an MTL file's
    return np.array(kd) if plain is None and np.shape(kd) == (3,) else plain


def _shares(array: Any) -> Floats:
    """(..., 3) of colours; whole numbers are shares of the largest of their type."""
    array = np.asarray(array)[..., :3]
    return array / (np.iinfo(array.dtype).max if array.dtype.kind in "iu" else 1.0)
