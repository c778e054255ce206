"""A mesh file, read: its triangles in one list, with the colours that they carry."""

from __future__ import annotations

import functools
import io
import logging
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from logging.handlers import BufferingHandler
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import lazy_loader
import numpy as np

from nbv.errors import UserError
from nbv.rocks import materials
from nbv.rocks.gltf import EXTENSION, rewritten_gltf
from nbv.rocks.materials import COLOR, UV, Material, UnusableMesh
from nbv.rocks.mesh import drop_unused_vertices
from nbv.rocks.texture import Linear, linear_from_srgb, linear_image
from nbv.safe_files import is_file, read_bytes, require
from nbv.types import Floats, Ints

MAX_COORDINATE = 1e9  # a map's in millimetres are below
MAX_FACES = 5_000_000
MAX_FILE_BYTES = 2 * 1024**3
MAX_SIDE_FILE_BYTES = 1024**3  # materials, textures and buffers, each
MAX_UNPACKED_BYTES = 1024**3
MAX_MEMBERS = 100_000
GLTF = (".glb", ".gltf")
trimesh: Any = lazy_loader.load("trimesh")  # half a second, and most commands read no mesh
_PACKED = (".zip", ".gz", ".bz2", ".xz", ".tar", ".tgz", ".7z")


@dataclass(frozen=True)
class FileMesh:
    """Triangles of a whole file, with their vertices' attributes; a vertex is there once for each of its colours."""

    values: Floats  # (V, 9): x, y, z; a linear colour, or NaN; texture coordinates u, v; index of the texture, or -1
    faces: Ints  # (F, 3)
    textures: list[tuple[Linear, tuple[str, ...]]]  # with how it goes on beyond 0 to 1, see `Material`
    step: float  # the coarsest, between neighbouring values of a coordinate, in the file's unit; 0 where there is none


def read_mesh_file(path: Path, notes: list[str]) -> FileMesh:
    """All triangles of the file's scene; ``notes`` gets what is out of the ordinary, and what was not read.

    `UnusableMesh` where the file is unreadable, empty, without faces, not finite or far too large; `UserError` for an archive or a
    texture that is far too large, and where an extra is not installed.
    """
    size = path.stat().st_size
    if size == 0:
        raise UnusableMesh("is empty")
    if size > MAX_FILE_BYTES:
        raise UnusableMesh(f"has {size / 1e9:.1f} GB; decimate it first")
    _check_archive(path)
    scene, attributes = _load(path, notes)
    placed = [
        (scene.geometry[name], transform)
        for transform, name in map(scene.graph.get, scene.graph.nodes_geometry)
    ]
    parts = [(part, at) for part, at in placed if isinstance(part, trimesh.Trimesh) and len(part.faces)]
    if not parts:
        raise UnusableMesh("holds no faces; export a triangle mesh, not points or lines")
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
        determinant = float(np.linalg.det(transform[:3, :3]))
        step = max(step, coarsest_step(points) * abs(determinant) ** (1 / 3))
        points = points @ transform[:3, :3].T + transform[:3, 3]
        carried = attributes(part)
        if len(carried) != len(points):  # of every corner by itself
            points, corners = points[corners].reshape(-1, 3), np.arange(corners.size).reshape(-1, 3)
        if determinant < 0:  # a mirroring node turns faces inside out
            corners = corners[:, ::-1]
        values.append(np.hstack([points, carried]))
        faces.append(corners + offset)
        offset += len(points)
    if len(parts) > 1:
        notes.append(f"joined {len(parts)} meshes of the file's scene")
    whole = drop_unused_vertices(np.concatenate(values), np.concatenate(faces))
    mesh = FileMesh(*whole, attributes.textures, step)
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
    """The step of the coordinate whose values lie on the coarsest grid: as stored in single precision, or as they look.

    Of the latter only where the vertices are four times as many as a coordinate's values, and a hundred: 0 otherwise.
    """
    coarsest = 0.0
    for column in points.T[:, (np.abs(points) <= MAX_COORDINATE).all(axis=1)]:
        values = np.unique(column)
        single = values.astype(np.float32)
        if len(values) and (single == values).all():
            coarsest = max(coarsest, float(np.spacing(np.abs(single).max())))
        gaps = np.diff(values)
        if len(points) >= max(100, 4 * len(values)) and len(gaps) > 1:
            counts = gaps / gaps.min()
            coarsest = max(
                coarsest, float(gaps.min()) if np.abs(counts - np.rint(counts)).max() < 1e-3 else 0.0
            )
    return coarsest


def _load(path: Path, notes: list[str]) -> tuple[Any, VertexAttributes]:
    """The file's scene as trimesh reads it, and what reads the attributes of its parts."""
    kind, content, files = path.suffix.lower(), path.read_bytes(), _SideFiles(path.parent)
    attributes, options = VertexAttributes(notes), dict[str, Any]()
    if kind in GLTF:
        content, attributes.materials = rewritten_gltf(content, str(path), notes)
    elif kind == ".obj":
        content, files.given, attributes.materials = materials.rewritten_obj(content, files.get, notes)
    elif kind == ".ply":
        names = materials.ply_images(content)
        attributes.images = [materials.open_image(files.get, name, notes) for name in names]
        options = {"fix_texture": bool(names), "skip_materials": True}
    heard, log = BufferingHandler(1000), logging.getLogger("trimesh")
    log.addHandler(heard)
    try:
        scene = trimesh.load_scene(
            io.BytesIO(content), file_type=kind[1:], process=False, resolver=files, **options
        )
    except Exception as error:  # loaders raise whatever their parsers do
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        raise UnusableMesh(f"cannot be read: {reason}") from error
    finally:
        log.removeHandler(heard)
    for message in (record.getMessage() for record in heard.buffer):
        if message.startswith("failed to process extension"):
            told = message.removeprefix("failed to process extension ").removeprefix(f"{EXTENSION}: ")
            raise UnusableMesh(f"cannot be read: {told[:160]}")
    return scene, attributes


def _check_archive(path: Path) -> None:
    """Raise for an archive, and for a file that unpacks to more than a mesh, as 3MF may."""
    if path.suffix.lower() in _PACKED:
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


class _SideFiles:
    """Where trimesh finds what the mesh names: regular files of a size, in the mesh's folder or below.

    A name in another letter case, with other slashes or with a folder of another machine stands for the one file that fits.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()
        self.given: Mapping[str, bytes] = {}  # what needs no file

    def get(self, name: str) -> bytes:
        """The content of a file; `UserError` where there is none that may be read."""
        if name in self.given:
            return self.given[name]
        plain = unquote(name.strip()).replace("\\", "/")
        for each in (name.strip(), plain, plain.rpartition("/")[2]):
            found = functools.reduce(_in_any_case, Path(each).parts, self.folder)
            if is_file(found) and found.resolve().is_relative_to(self.folder):
                return read_bytes(found, MAX_SIDE_FILE_BYTES)
        if not (self.folder / name.strip()).resolve().is_relative_to(self.folder):
            raise UserError(f"{name} is not in the mesh's folder")
        return read_bytes(self.folder / name.strip(), MAX_SIDE_FILE_BYTES)

    __getitem__ = get


def _in_any_case(folder: Path, name: str) -> Path:
    if (folder / name).exists() or not folder.is_dir():
        return folder / name
    same = [path for path in folder.iterdir() if path.name.casefold() == name.casefold()]
    return same[0] if len(same) == 1 else folder / name


class VertexAttributes:
    """Reads colours and texture coordinates of vertices, part by part of a scene."""

    def __init__(self, notes: list[str]) -> None:
        self.textures: list[tuple[Linear, tuple[str, ...]]] = []
        self.materials: dict[str, Material] = {}  # of glTF and OBJ, by the name of a material
        self.images: list[Material] | None = None  # of PLY
        self._notes = notes
        self._opened: dict[Any, int] = {}  # index of a texture by the identity of its picture

    def __call__(self, part: Any) -> Floats:
        """(V, 6) a linear colour or NaN, u, v, index of the texture or -1; (3F, 6) where corners of faces differ."""
        visual, attributes = part.visual, part.vertex_attributes
        read = getattr(visual, "material", None)  # by trimesh
        uv = attributes.get(UV, getattr(visual, "uv", None))
        if self.images and uv is not None:
            return self._of_images(part, uv, self.images)
        srgb = None
        if self.images is not None:
            by_face, srgb = materials.ply_colors(part)
        elif visual.kind in ("vertex", "face"):
            by_face, srgb = visual.kind == "face", getattr(visual, f"{visual.kind}_colors")[:, :3] / 255.0
        if srgb is not None:
            return _rows(linear_from_srgb(np.repeat(srgb, 3, axis=0) if by_face else srgb))
        material = self.materials.get(str(getattr(read, "name", None)), Material())
        if material.image is None and self.images is None:
            image = getattr(read, "baseColorTexture", None) or getattr(read, "image", None)
            material = replace(
                material, image=image, label=material.label or ("of the file" if image else "")
            )
        texture = -1
        if material.label and (uv is None or len(uv) != len(part.vertices) or not np.isfinite(uv).all()):
            self._notes.append(f"not read: texture {material.label!r}; the mesh has no coordinates for it")
        elif material.label:
            texture = self._texture(material)
        linear = np.full(3, np.nan) if material.color is None else linear_from_srgb(np.array(material.color))
        return _rows(attributes.get(COLOR, np.tile(linear, (len(part.vertices), 1))), uv, texture)

    def _of_images(self, part: Any, uv: Floats, images: list[Material]) -> Floats:
        """As of a PLY file, whose faces say which picture is theirs."""
        numbers = materials.ply_column(part, "face", "texnumber")
        textures = np.array([*map(self._texture, images), -1])
        if len(images) == 1:
            return _rows(np.full((len(uv), 3), np.nan), uv, textures[0])
        if numbers is None or len(numbers) != len(part.faces):
            self._notes.append(f"not read: {len(images)} textures; no face says which is its (texnumber)")
            return _rows(np.full((len(uv), 3), np.nan))
        of_corner = np.repeat(textures[np.clip(numbers, -1, len(images))], 3)
        return _rows(np.full((len(of_corner), 3), np.nan), uv[part.faces].reshape(-1, 2), of_corner)

    def _texture(self, material: Material) -> int:
        """Index of the material's picture among `textures`; -1 and a note where it cannot be read."""
        key = (id(material.image), material.wrap)
        if key not in self._opened:
            self._opened[key] = -1
            try:
                if material.image is None:
                    raise ValueError("missing, or of a format that is not read")
                self.textures.append((linear_image(material.image), material.wrap))
                self._opened[key] = len(self.textures) - 1
            except (OSError, ValueError, SyntaxError) as error:
                self._notes.append(
                    f"not read: texture {material.label!r} ({' '.join(str(error).split())[:80]})"
                )
        return self._opened[key]


def _rows(linear: Floats | Linear, uv: Floats | None = None, texture: Any = -1) -> Floats:
    rows = np.column_stack(
        [linear, np.zeros((len(linear), 2)) if uv is None else uv, np.full(len(linear), texture)]
    )
    rows[:, :3][np.isnan(rows[:, :3]) & (rows[:, 5:] >= 0)] = 1.0
    return rows
