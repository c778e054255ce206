"""A mesh file, read: its triangles in one list, with the colours that they carry."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from nbv.rocks.mesh import drop_unused_vertices
from nbv.rocks.texture import Linear, linear_from_srgb, linear_image
from nbv.safe_files import read_bytes, require
from nbv.types import Floats, Ints

MAX_COORDINATE = 1e9  # a map's in millimetres are below
MAX_FACES = 5_000_000
MAX_FILE_BYTES = 2 * 1024**3
MAX_SIDE_FILE_BYTES = 1024**3  # materials, textures and buffers, each
MAX_UNPACKED_BYTES = 1024**3
MAX_MEMBERS = 100_000
_BLIND_ARCHIVES = (".gz", ".bz2", ".xz", ".tar", ".tgz", ".7z")


class UnusableMesh(Exception):
    """Why a mesh file is no rock: what reads on after "mesh file NAME"."""


@dataclass(frozen=True)
class Soup:
    """Triangles of a whole file, with what their vertices carry; a vertex is there once for each of its colours."""

    values: Floats  # (V, 7): x, y, z; texture coordinates u, v, - or a linear colour; index of the texture, or below
    faces: Ints  # (F, 3)
    images: list[Linear]

    NOTHING: ClassVar[int] = -1  # in place of the index of a texture
    COLOR: ClassVar[int] = -2


def read_mesh_file(path: Path, notes: list[str]) -> Soup:
    """All triangles of the file's scene; ``notes`` gets what is out of the ordinary.

    Raises
    ------
    UnusableMesh
        The file is unreadable, empty, without faces, not finite or far too large.
    UserError
        It is an archive, or has a texture, far too large.
    """
    import trimesh  # noqa: PLC0415  half a second to load

    size = path.stat().st_size
    if size == 0:
        raise UnusableMesh("is empty")
    if size > MAX_FILE_BYTES:
        raise UnusableMesh(f"has {size / 1e9:.1f} GB; decimate it first")
    _check_archive(path)
    try:
        scene = trimesh.load_scene(path, process=False, resolver=_side_files(path))
    except Exception as error:  # loaders raise whatever their parsers do
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        raise UnusableMesh(f"cannot be read: {reason}") from error
    placed = [scene.graph[node] for node in scene.graph.nodes_geometry]
    parts = [
        (scene.geometry[name], np.asarray(transform, dtype=float))
        for transform, name in placed
        if isinstance(scene.geometry[name], trimesh.Trimesh) and len(scene.geometry[name].faces)
    ]
    if not parts:
        raise UnusableMesh("holds no faces; export a triangle mesh, not points or lines")
    count = sum(len(part.faces) for part, _ in parts)
    if count > MAX_FACES:
        raise UnusableMesh(
            f"has {count / 1e6:.1f} million faces; decimate it to {MAX_FACES / 1e6:g} million or fewer"
        )
    values, faces = [], []
    images: list[Linear] = []
    offset = 0
    linear_colors = path.suffix.lower() in (".glb", ".gltf")  # glTF stores vertex colours linearly
    for part, transform in parts:
        corners, points = np.asarray(part.faces, dtype=np.int64), np.asarray(part.vertices, dtype=float)
        if points.ndim != 2 or points.shape[1] != 3 or corners.min() < 0 or corners.max() >= len(points):
            raise UnusableMesh("has faces that name vertices it does not hold; export it again")
        points = points @ transform[:3, :3].T + transform[:3, 3]
        if part.visual.kind == "face":  # every corner by itself
            points, corners = points[corners].reshape(-1, 3), np.arange(corners.size).reshape(-1, 3)
        if np.linalg.det(transform[:3, :3]) < 0:  # a mirroring node turns faces inside out
            corners = corners[:, ::-1]
        carried, image = _skin(part, linear_colors, notes)
        kind = Soup.NOTHING if carried is None else Soup.COLOR
        if image is not None:
            kind = len(images)
            images.append(image)
        carried = np.zeros_like(points) if carried is None else carried
        values.append(np.column_stack([points, carried, np.full(len(points), kind)]))
        faces.append(corners + offset)
        offset += len(points)
    if len(parts) > 1:
        notes.append(f"joined {len(parts)} meshes of the file's scene")
    soup = Soup(*drop_unused_vertices(np.concatenate(values), np.concatenate(faces)), images)
    bad = ~np.isfinite(soup.values[:, :3]).all(axis=1)
    if bad.any():
        raise UnusableMesh(f"has {bad.sum()} vertices that are not finite numbers; repair or re-export it")
    reach = float(np.abs(soup.values[:, :3]).max())
    if reach > MAX_COORDINATE:
        raise UnusableMesh(
            f"has a coordinate of {reach:.3g}; the limit is {MAX_COORDINATE:g}, export it again"
        )
    return soup


def _check_archive(path: Path) -> None:
    """Raise for an archive that unpacks to more than a mesh, and for one whose size nobody knows before."""
    if path.suffix.lower() in _BLIND_ARCHIVES:
        raise UnusableMesh("is packed; unpack it first")
    if zipfile.is_zipfile(path):
        try:
            with zipfile.ZipFile(path) as archive:
                members = archive.infolist()
        except (zipfile.BadZipFile, OSError, ValueError) as error:
            raise UnusableMesh(f"cannot be read: {error}") from error
        require(len(members), MAX_MEMBERS, f"the number of files in {path}")
        unpacked = sum(member.file_size for member in members)
        require(unpacked, MAX_UNPACKED_BYTES, f"the unpacked size of {path} in bytes")


def _side_files(path: Path) -> Any:
    """Where the loader finds what the mesh names: regular files of a size, in the mesh's folder or below."""
    import trimesh  # noqa: PLC0415  half a second to load

    class SideFiles(trimesh.resolvers.FilePathResolver):  # type: ignore[misc]
        def get(self, name: str) -> bytes:
            return read_bytes(self.absolute(name), MAX_SIDE_FILE_BYTES)

        def namespaced(self, namespace: str) -> SideFiles:
            return SideFiles(str(Path(self.parent) / namespace))

    return SideFiles(str(path))


def _skin(part: Any, linear_colors: bool, notes: list[str]) -> tuple[Floats | None, Linear | None]:
    """What each vertex carries, (V, 3), and the texture that it lies on; with colours by face, of every corner."""
    kind = part.visual.kind
    if kind in ("vertex", "face"):
        raw = part.visual.vertex_colors if kind == "vertex" else np.repeat(part.visual.face_colors, 3, axis=0)
        colors = np.asarray(raw, dtype=float)[:, :3] / 255.0
        return (colors if linear_colors else linear_from_srgb(colors).astype(float)), None
    if kind != "texture":
        return None, None
    material, uv = part.visual.material, getattr(part.visual, "uv", None)
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    if image is None or uv is None or len(uv) != len(part.vertices) or not np.isfinite(uv).all():
        if image is not None or uv is not None:
            notes.append("the texture's image or its coordinates are missing or cannot be read")
        return None, None
    try:
        linear = linear_image(image)
    except (OSError, ValueError, SyntaxError) as error:
        notes.append(f"the texture image cannot be read: {' '.join(str(error).split())[:80]}")
        return None, None
    factor = getattr(material, "baseColorFactor", None)
    if factor is not None:
        scale = np.asarray(factor, dtype=np.float32)[:3]
        linear = linear * (scale / np.float32(255) if scale.max() > 1 else scale)
    return np.column_stack([uv, np.zeros(len(uv))]), linear
