"""A mesh file, read: its triangles in one list, with the colours that they carry."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

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


@dataclass
class Skin:
    """Where the colours of one part of a mesh come from."""

    kind: Literal["texture", "colors", "none"]
    image: Linear | None = None  # linear, for "texture"


@dataclass
class Soup:
    """Triangles of a whole file in one list, with what their corners carry."""

    vertices: Floats  # (V, 3)
    faces: Ints  # (F, 3)
    skins: list[Skin]
    skin: Ints  # (F,) index into `skins`
    corner: Floats  # (F, 3, 3): texture coordinates (u, v, -) or a linear colour, by the face's skin


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
    vertices, faces, skins, skin, corner = [], [], [], [], []
    offset = 0
    linear_colors = path.suffix.lower() in (".glb", ".gltf")  # glTF stores vertex colours linearly
    for index, (part, transform) in enumerate(parts):
        local_faces = np.asarray(part.faces, dtype=np.int64)
        local = np.asarray(part.vertices, dtype=float)
        if local.ndim != 2 or local.shape[1] != 3:
            raise UserError(
                f"mesh file {str(path)!r} has vertices of other than 3 coordinates; export it again"
            )
        if local_faces.min() < 0 or local_faces.max() >= len(local):
            raise UserError(f"mesh file {str(path)!r} has faces that name vertices it does not hold")
        one, values = _skin(part, linear_colors, notes)
        skins.append(one)
        corner.append(values)
        skin.append(np.full(len(local_faces), index, dtype=np.int64))
        if np.linalg.det(transform[:3, :3]) < 0:  # a mirroring node turns faces inside out
            local_faces = local_faces[:, ::-1]
            corner[-1] = values[:, ::-1]
        vertices.append(local @ transform[:3, :3].T + transform[:3, 3])
        faces.append(local_faces + offset)
        offset += len(local)
    if len(parts) > 1:
        notes.append(f"joined {len(parts)} meshes of the file's scene")
    soup = Soup(
        np.concatenate(vertices), np.concatenate(faces), skins, np.concatenate(skin), np.concatenate(corner)
    )
    bad = np.any(~np.isfinite(soup.vertices), axis=1)
    if np.any(np.take(bad, soup.faces)):
        raise UserError(
            f"mesh file {str(path)!r} has {int(bad.sum())} vertices that are not finite numbers; "
            "repair or re-export it"
        )
    reach = float(np.abs(soup.vertices[soup.faces]).max())
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


def _skin(part: Any, linear_colors: bool, notes: list[str]) -> tuple[Skin, Floats]:
    """The part's source of colour and what each corner carries, (F, 3, 3)."""
    faces = np.asarray(part.faces)
    nothing = np.zeros((len(faces), 3, 3))
    kind = part.visual.kind
    if kind == "texture":
        material = part.visual.material
        image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
        uv = getattr(part.visual, "uv", None)
        if image is None or uv is None or len(uv) != len(part.vertices) or not np.isfinite(uv).all():
            if uv is not None and image is None:
                notes.append("the texture image is missing or cannot be read")
            elif image is not None:
                notes.append("the mesh has a texture but no usable texture coordinates")
            return Skin("none"), nothing
        try:
            linear = linear_image(image)
        except (OSError, ValueError, SyntaxError) as error:
            notes.append(f"the texture image cannot be read: {' '.join(str(error).split())[:80]}")
            return Skin("none"), nothing
        factor = getattr(material, "baseColorFactor", None)
        if factor is not None:
            scale = np.asarray(factor, dtype=np.float32)[:3]
            linear = linear * (scale / np.float32(255) if scale.max() > 1 else scale)
        nothing[..., :2] = np.asarray(uv, dtype=float)[faces]
        return Skin("texture", linear), nothing
    if kind in ("vertex", "face"):
        raw = part.visual.vertex_colors if kind == "vertex" else part.visual.face_colors
        colors = np.asarray(raw, dtype=float)[:, :3] / 255.0
        if not linear_colors:
            colors = linear_from_srgb(colors).astype(float)
        return Skin("colors"), colors[faces] if kind == "vertex" else np.repeat(colors[:, None], 3, axis=1)
    return Skin("none"), nothing
