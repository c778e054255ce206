"""A mesh file, read: its triangles in one list, with the colours that they carry."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from nbv.errors import UserError
from nbv.rocks.texture import (
    Linear,
    linear_from_srgb,
    linear_image,
)
from nbv.safe_files import read_bytes, require
from nbv.types import Floats, Ints

MAX_COORDINATE = 1e9  # a map's in millimetres are below
MAX_FACES = 5_000_000
MAX_FILE_BYTES = 2 * 1024**3
MAX_SIDE_FILE_BYTES = 1024**3  # materials, textures and buffers, each
MAX_UNPACKED_BYTES = 1024**3
MAX_MEMBERS = 100_000
_BLIND_ARCHIVES = (".gz", ".bz2", ".xz", ".tar", ".tgz", ".7z")


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
    UserError
        The file is missing, unreadable, empty, without faces, not finite or far too large.
    """
    import trimesh  # noqa: PLC0415  half a second to load

    if not path.is_file():
        raise UserError(f"there is no mesh file {str(path)!r}; check the path")
    size = path.stat().st_size
    if size == 0:
        raise UserError(f"mesh file {str(path)!r} is empty")
    if size > MAX_FILE_BYTES:
        raise UserError(f"mesh file {str(path)!r} has {size / 1e9:.1f} GB; decimate it first")
    _check_archive(path)
    try:
        scene = trimesh.load_scene(path, process=False, resolver=_side_files(path))
    except Exception as error:  # loaders raise whatever their parsers do
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        raise UserError(f"mesh file {str(path)!r} cannot be read: {reason}") from error
    parts: list[tuple[Any, Floats]] = []
    for node in scene.graph.nodes_geometry:
        transform, geometry_name = scene.graph[node]
        geometry = scene.geometry[geometry_name]
        if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces):
            parts.append((geometry, np.asarray(transform, dtype=float)))
    if not parts:
        raise UserError(
            f"mesh file {str(path)!r} holds no faces; export a triangle mesh, not points or lines"
        )
    count = sum(len(part.faces) for part, _ in parts)
    if count > MAX_FACES:
        raise UserError(
            f"mesh file {str(path)!r} has {count / 1e6:.1f} million faces; decimate it to "
            f"{MAX_FACES / 1e6:g} million or fewer"
        )
    values, faces = [], []
    images: list[Linear] = []
    offset = 0
    linear_colors = path.suffix.lower() in (".glb", ".gltf")  # glTF stores vertex colours linearly
    for part, transform in parts:
        local_faces = np.asarray(part.faces, dtype=np.int64)
        local = np.asarray(part.vertices, dtype=float)
        if local.ndim != 2 or local.shape[1] != 3:
            raise UserError(
                f"mesh file {str(path)!r} has vertices of other than 3 coordinates; export it again"
            )
        if local_faces.min() < 0 or local_faces.max() >= len(local):
            raise UserError(f"mesh file {str(path)!r} has faces that name vertices it does not hold")
        placed = local @ transform[:3, :3].T + transform[:3, 3]
        if part.visual.kind == "face":  # every corner by itself
            placed, local_faces = (
                placed[local_faces].reshape(-1, 3),
                np.arange(local_faces.size).reshape(-1, 3),
            )
        if np.linalg.det(transform[:3, :3]) < 0:  # a mirroring node turns faces inside out
            local_faces = local_faces[:, ::-1]
        carried, image = _skin(part, linear_colors, notes)
        kind = Soup.NOTHING if carried is None else Soup.COLOR
        if image is not None:
            kind = len(images)
            images.append(image)
        carried = np.zeros((1, 3)) if carried is None else carried
        values.append(
            np.hstack([placed, np.broadcast_to(carried, placed.shape), np.full((len(placed), 1), kind)])
        )
        faces.append(local_faces + offset)
        offset += len(placed)
    if len(parts) > 1:
        notes.append(f"joined {len(parts)} meshes of the file's scene")
    soup = Soup(np.concatenate(values), np.concatenate(faces), images)
    bad = np.any(~np.isfinite(soup.values[:, :3]), axis=1)
    if np.any(np.take(bad, soup.faces)):
        raise UserError(
            f"mesh file {str(path)!r} has {int(bad.sum())} vertices that are not finite numbers; "
            "repair or re-export it"
        )
    reach = float(np.abs(soup.values[np.unique(soup.faces), :3]).max())
    if reach > MAX_COORDINATE:
        raise UserError(
            f"mesh file {str(path)!r} has a coordinate of {reach:.3g}; the limit is {MAX_COORDINATE:g}, export it again"
        )
    return soup


def _check_archive(path: Path) -> None:
    """`UserError` for an archive that unpacks to more than a mesh, and for one whose size nobody knows before."""
    if path.suffix.lower() in _BLIND_ARCHIVES:
        raise UserError(f"mesh file {str(path)!r} is packed; unpack it first")
    if zipfile.is_zipfile(path):
        try:
            with zipfile.ZipFile(path) as archive:
                members = archive.infolist()
        except (zipfile.BadZipFile, OSError, ValueError) as error:
            raise UserError(f"mesh file {str(path)!r} cannot be read: {error}") from error
        require(len(members), MAX_MEMBERS, f"the number of files in {path}")
        require(
            sum(m.file_size for m in members), MAX_UNPACKED_BYTES, f"the unpacked size of {path} in bytes"
        )


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
