"""Any mesh that trimesh reads, made into a rock: one body, upright, 1.6 m tall, resting on the ground."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from nbv.errors import UserError
from nbv.geometry.frames import Similarity
from nbv.rocks import mesh as meshes
from nbv.rocks.imported_albedo import FineMesh, imported_albedo
from nbv.rocks.mesh_file import Soup, read_mesh_file
from nbv.rocks.rock import DEFAULT_HEIGHT_M, SPLITS, Rock, Split, make_rock
from nbv.safe_files import expanded
from nbv.types import Floats, Ints

Up = Literal["auto", "x", "y", "z", "-x", "-y", "-z"]


MAX_EDGE_M = 0.009  # longest edge after subdivision; the mean comes out below 6 mm
MAX_FINE_FACES = 3_000_000  # beyond this the subdivision is coarser
MAX_REACH_M = 3.0  # viewpoints fly 3.5 m from the target


_UP = {
    "x": np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]], dtype=float),
    "-x": np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], dtype=float),
    "y": np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], dtype=float),
    "-y": np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], dtype=float),
    "z": np.eye(3),
    "-z": np.diag([1.0, -1.0, -1.0]),
}


def import_mesh(
    path: str | Path,
    *,
    name: str | None = None,
    height_m: float = DEFAULT_HEIGHT_M,
    split: Split = "train",
    difficulty: str | None = None,
    up: Up = "auto",
) -> Rock:
    """Make a rock of a mesh file (OBJ with MTL and texture, GLB, PLY, STL, ... whatever trimesh reads).

    Duplicate vertices are merged, the body with the largest surface is kept, the mesh is turned upright,
    scaled to ``height_m``, set on the ground and subdivided until no edge is longer than 9 mm, so that
    vertices can carry the texture. Subdivision does not move the surface. The albedo is the mesh's own texture or
    colours (taken as sRGB), else procedural. Everything done is told in the rock's notes.

    Parameters
    ----------
    name
        Default: the file's name in lower case.
    difficulty
        A phrase for the catalogue; default: the overhang, measured.
    up
        The file's upward axis. ``auto`` takes y for glTF, as its standard says, and z for everything else.

    Raises
    ------
    UserError
        The file is missing, unreadable, empty, not a surface, not finite, flat or far too large.
    """
    path = expanded(path)
    if up != "auto" and up not in _UP:
        raise UserError(f"up is {up!r}; allowed: {', '.join(get_args(Up))}")
    if split not in SPLITS:
        raise UserError(f"split is {split!r}; allowed: {', '.join(SPLITS)}")
    if not 0.1 <= height_m <= 5.0:
        raise UserError(f"height_m is {height_m!r}; it must be between 0.1 and 5 m")
    notes: list[str] = []
    soup = read_mesh_file(path, notes)
    soup = _clean(soup, path, notes)

    axis = _upward(path, up)
    if axis != "z":
        soup.vertices = soup.vertices @ _UP[axis].T
        notes.append(f"turned upright: the file's {axis} axis is up" + (" (glTF)" if up == "auto" else ""))
    _refuse_flat(soup, path)
    vertices, scale = meshes.rest_on_ground(soup.vertices, height_m)
    notes.append(f"scaled by {scale:.6g} to {height_m:g} m height and set on the ground")
    faces = _outward(vertices, soup.faces, notes)
    if faces is not soup.faces:
        soup.corner = soup.corner[:, ::-1]
    _check_reach(vertices, height_m, path, notes)

    area = float(meshes.face_areas(vertices, faces).sum())
    # Equilateral triangles of the mean edge that subdivision gives, about 0.6 of the longest.
    max_edge = max(MAX_EDGE_M, float(np.sqrt(area / MAX_FINE_FACES / 0.433)) / 0.6)
    if max_edge > MAX_EDGE_M:
        notes.append(f"{area:.0f} m2 of surface: subdivided to {max_edge * 1e3:.0f} mm only")
    soup.vertices, soup.faces = vertices, faces
    fine = FineMesh(*meshes.refine(vertices, faces, max_edge), max_edge)
    if len(fine.faces) > len(faces):
        notes.append(f"subdivided from {len(faces)} to {len(fine.faces)} faces; the surface is unchanged")
    return make_rock(
        name or _default_name(path),
        fine.vertices,
        fine.faces,
        imported_albedo(soup, fine, notes),
        split=split,
        difficulty=difficulty or _measured_difficulty(vertices, faces),
        notes=tuple(notes),
    )


def frame_of_file(path: str | Path) -> Similarity:
    """From a mesh file's own frame to the one in which `import_mesh` puts it by default; errors as there."""
    path = expanded(path)
    notes: list[str] = []
    soup = _clean(read_mesh_file(path, notes), path, notes)
    turned = soup.vertices @ _UP[_upward(path, "auto")].T
    placed, scale = meshes.rest_on_ground(turned, DEFAULT_HEIGHT_M)
    return Similarity(scale, _UP[_upward(path, "auto")], placed[0] - scale * turned[0])


def _upward(path: Path, up: Up) -> str:
    return ("y" if path.suffix.lower() in (".glb", ".gltf") else "z") if up == "auto" else up


def _default_name(path: Path) -> str:
    return re.sub(r"[^a-z0-9_-]+", "-", path.stem.lower()).strip("-_")[:64] or "rock"


def _measured_difficulty(vertices: Floats, faces: Ints) -> str:
    areas, normals = meshes.face_areas(vertices, faces), meshes.face_normals(vertices, faces)
    share = areas[normals[:, 2] < -np.sin(np.deg2rad(10.0))].sum() / areas.sum()
    return f"imported; {100 * share:.0f} % of the surface leans over"


def _clean(soup: Soup, path: Path, notes: list[str]) -> Soup:
    """Merge duplicate vertices, drop collapsed and repeated faces and all but the largest body."""
    vertices, faces = meshes.drop_unused_vertices(soup.vertices, soup.faces)
    size = float((vertices.max(0) - vertices.min(0)).max())
    if size <= 0:
        raise UserError(f"mesh file {str(path)!r} has no extent: all vertices coincide")
    keys = np.round((vertices - vertices.min(0)) / (1e-6 * size)).astype(np.int64)
    _, first, merged = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    merged = merged.reshape(-1)
    if len(first) < len(vertices):
        notes.append(f"merged {len(vertices) - len(first)} duplicate vertices (seams)")
    faces, vertices = merged[faces], vertices[first]

    collapsed = (faces == np.roll(faces, 1, axis=1)).any(1)
    unique = np.zeros(len(faces), dtype=bool)
    unique[np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]] = True
    good = unique & ~collapsed
    if not good.all():
        notes.append(f"dropped {int((~good).sum())} collapsed or repeated faces")
    areas = meshes.face_areas(vertices, faces)
    if not good.any() or areas[good].sum() <= 1e-12 * size * size:
        raise UserError(f"mesh file {str(path)!r} has no surface: all its faces have zero area")

    labels = meshes.body_labels(faces[good])
    body_areas = np.bincount(labels, weights=areas[good])
    if len(body_areas) > 1:
        best = int(np.argmax(body_areas))
        share = body_areas[best] / body_areas.sum()
        notes.append(f"kept the largest of {len(body_areas)} bodies, {100 * share:.1f} % of the surface")
        good[np.flatnonzero(good)[labels != best]] = False
    vertices, faces = meshes.drop_unused_vertices(vertices, faces[good])
    return Soup(vertices, faces, soup.skins, soup.skin[good], soup.corner[good])


def _refuse_flat(soup: Soup, path: Path) -> None:
    extents = soup.vertices.max(0) - soup.vertices.min(0)
    centered = soup.vertices - soup.vertices.mean(0)
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(centered.T @ centered / len(centered)), 0))
    if spread[0] < 1e-4 * spread[2] or extents[2] < 1e-4 * extents.max():
        raise UserError(f"mesh file {str(path)!r} is flat; a rock needs three dimensions")


def _outward(vertices: Floats, faces: Ints, notes: list[str]) -> Ints:
    """The faces, all turned if the surface is inside out; says what is not closed or consistent."""
    import trimesh  # noqa: PLC0415  half a second to load

    counts = meshes.edge_face_counts(faces)
    if (counts == 1).any():
        notes.append(f"not watertight: {int((counts == 1).sum())} edges have one face only")
    if (counts > 2).any():
        notes.append(f"{int((counts > 2).sum())} edges have three faces or more")
    directed = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    keys = directed[:, 0] * len(vertices) + directed[:, 1]
    if len(np.unique(keys)) < len(keys):
        fixed = trimesh.Trimesh(vertices, faces, process=False)
        trimesh.repair.fix_winding(fixed)
        turned = (np.asarray(fixed.faces) != faces).any(1)
        if turned.any():
            notes.append(f"turned {int(turned.sum())} faces that wound against their neighbours")
            # Reversed corners, not trimesh's order, so that what corners carry can follow.
            faces = np.where(turned[:, None], faces[:, ::-1], faces)
    if meshes.signed_volume(vertices, faces) < 0:
        notes.append("turned inside out")
        faces = faces[:, ::-1]
    return faces


def _check_reach(vertices: Floats, height_m: float, path: Path, notes: list[str]) -> None:
    reach = float(np.linalg.norm(vertices - (0, 0, height_m / 2), axis=1).max())
    if reach > MAX_REACH_M:
        raise UserError(
            f"mesh file {str(path)!r} reaches {reach:.1f} m from its centre when {height_m:g} m tall, into the "
            "viewpoints 3.5 m away; choose another up axis or a smaller height"
        )
    half = float(np.abs(vertices[:, :2]).max())
    if half > 1.5:
        notes.append(f"reaches {half:.2f} m sideways, beyond the evaluation's default crop of 1.5 m")
