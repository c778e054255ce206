"""A mesh file made into a rock: one object, upright, 1.6 m tall, resting on the ground."""

from __future__ import annotations

import re
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import lazy_loader
import numpy as np

from nbv.cache import Arrays, Store, cached, digest
from nbv.errors import UserError
from nbv.geometry import mesh as meshes
from nbv.rocks.mesh_file import GLTF, MAX_FILE_BYTES, FileMesh, UnusableMesh, read_mesh_file, side_files
from nbv.rocks.rock import (
    DEFAULT_HEIGHT_M,
    SPLITS,
    Rock,
    Split,
    make_rock,
    overhanging_share,
    rock_arrays,
    rock_of,
)
from nbv.rocks.texture import fill_gutters, procedural_albedo, sample, shrink, texel_side
from nbv.safe_files import expanded, is_file, read_bytes
from nbv.types import Floats, Ints

trimesh: Any = lazy_loader.load("trimesh")  # half a second, and most commands read no mesh
MAX_EDGE_M = 0.009  # longest edge after subdivision; the mean comes out below 6 mm
MAX_FINE_FACES = 3_000_000  # beyond this the subdivision is coarser
SURELY = 1.2  # so many times the limit foretold, and subdivision passes it
LOWEST_M = 0.1  # a target is no lower
MAX_REACH_M = 3.0  # viewpoints are 3.5 m from the target
MAX_LISTED = 8  # bodies, by size
MAX_STEP, FAR = 0.002, 100.0  # of coordinates, and how far they are, in sizes of the body
ONE_COLOR = 0.004  # standard deviation below which a mesh's own colours say nothing

_UP = {
    "x": np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]], dtype=float),
    "y": np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], dtype=float),
    "z": np.eye(3),
    "-x": np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], dtype=float),
    "-y": np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], dtype=float),
    "-z": np.diag([1.0, -1.0, -1.0]),
}


def import_mesh(
    path: str | Path,
    *,
    name: str | None = None,
    height_m: float = DEFAULT_HEIGHT_M,
    split: Split = "train",
    up: str = "auto",
    body: int | None = None,
) -> Rock:
    """Make a rock of a mesh file (OBJ with MTL and texture, GLB, glTF, PLY, STL or OFF).

    It is subdivided until no edge is longer than 9 mm, so that vertices can carry the texture. The albedo is the mesh's own
    texture or colours, else procedural. The rock's notes say all that was done, and list the bodies of the file: all together are the
    target, or with ``body`` one of them, 1 the one of most surface. ``up`` is the file's upward axis: ``auto`` takes y for glTF, as its
    standard says, and z for everything else.

    `UserError` where the file is missing, unreadable, empty, not a surface, not finite, flat or far too large.
    """
    path = expanded(path)
    if up not in ("auto", *_UP):
        raise UserError(f"up is {up!r}; allowed: {', '.join(('auto', *_UP))}")
    if split not in SPLITS:
        raise UserError(f"split is {split!r}; allowed: {', '.join(SPLITS)}")
    if not LOWEST_M <= height_m <= 5.0:
        raise UserError(f"height_m is {height_m!r}; it must be between {LOWEST_M:g} and 5 m")
    if body is not None and body < 1:
        raise UserError(f"body is {body}; the largest is 1")
    if not path.is_file():
        raise UserError(f"there is no mesh file {str(path)!r}; check the path")
    notes: list[str] = []
    axis = up if up != "auto" else "y" if path.suffix.lower() in GLTF else "z"
    try:
        mesh = _clean(read_mesh_file(path, notes), body, notes)
        if axis != "z":
            notes.append(
                f"turned upright: the file's {axis} axis is up" + (" (glTF)" if up == "auto" else "")
            )
        mesh = _upright(mesh, _UP[axis], height_m, notes)
    except UnusableMesh as error:
        raise UserError(f"mesh file {str(path)!r} {error}") from error
    area_m2 = float(meshes.face_areas(mesh.values[:, :3], mesh.faces).sum())
    # Equilateral triangles of the mean edge that subdivision gives, about 0.6 of the longest.
    max_edge_m = max(MAX_EDGE_M, float(np.sqrt(area_m2 / MAX_FINE_FACES / 0.433)) / 0.6)
    if max_edge_m > MAX_EDGE_M:
        notes.append(f"{area_m2:.0f} m2 of surface: subdivided to {max_edge_m * 1e3:.0f} mm only")
    sides_m = np.sort(np.linalg.norm(np.diff(mesh.values[mesh.faces[:, [0, 1, 2, 0]], :3], axis=1), axis=2))
    if _foretold_faces(sides_m, max_edge_m) > SURELY * MAX_FINE_FACES:
        while _foretold_faces(sides_m, max_edge_m) > MAX_FINE_FACES:
            max_edge_m *= 1.1
        notes.append(f"many long, thin faces: subdivided to {max_edge_m * 1e3:.0f} mm only")
    # Both faces at an edge are split together: what is watertight stays so. What vertices carry is averaged.
    values, faces = trimesh.remesh.subdivide_to_size(mesh.values, mesh.faces, max_edge_m, max_iter=60)
    if len(faces) > len(mesh.faces):
        notes.append(f"subdivided from {len(mesh.faces)} to {len(faces)} faces; the surface is unchanged")
    colors = _own_colors(mesh, values, 0.6 * max_edge_m, notes)
    vertices, welded = np.unique(values[:, :3], axis=0, return_inverse=True)
    welded = welded.reshape(-1)
    faces = welded[faces]
    if colors is not None and colors.std(0).max() > ONE_COLOR:
        source = "texture" if mesh.textures else "colours"
        linear = source == "colours" and path.suffix.lower() in GLTF
        notes.append(
            f"albedo: the mesh's own {source}, {'linear in glTF' if linear else 'converted from sRGB to linear'}"
        )
        sums = np.stack([np.bincount(welded, weights=colors[:, c]) for c in range(3)], axis=1)
        albedo = (sums / np.bincount(welded)[:, None]).astype(np.float32)
    else:
        reason = "the mesh has no texture, and one colour or none"
        if path.suffix.lower() == ".off":
            reason = "colours of OFF are not read"
        elif any(note.startswith("not read") for note in notes):
            reason = "the mesh's own was not read"
        notes.append(f"albedo: procedural, since {reason}")
        coarse = np.unique(mesh.values[:, :3], axis=0)
        seed = zlib.crc32(np.round(coarse * 1e4).astype("<i8").tobytes()) & 0xFFFF
        albedo = procedural_albedo(vertices, meshes.vertex_normals(vertices, faces), seed)
    overhanging = overhanging_share(trimesh.Trimesh(mesh.values[:, :3], mesh.faces, process=False))
    return make_rock(
        name or re.sub(r"[^a-z0-9_-]+", "-", path.stem.lower()).strip("-_")[:64] or "rock",
        vertices,
        faces,
        albedo,
        split=split,
        difficulty=f"imported; {100 * overhanging:.0f} % of the surface leans over",
        notes=tuple(notes),
    )


def _foretold_faces(sides_m: Floats, max_edge_m: float) -> float:
    """About how many faces subdivision gives: one of sides (F, 3), the shortest first, becomes 4, 3 or 2 whenever 3, 2 or 1 are too long."""
    halved = np.maximum(np.ceil(np.log2(sides_m / max_edge_m)), 0)
    return float((2.0 ** halved[:, 2] * 1.5 ** halved[:, 1] * (4 / 3) ** halved[:, 0]).sum())


def stored_import(path: Path, store: Store | None) -> Rock:
    """`import_mesh` with its defaults, from ``store`` where the mesh file and those that it names are as they were then."""
    if store is None or path.stat().st_size > MAX_FILE_BYTES:
        return import_mesh(path)
    files = [path, *(path.parent / name for name in side_files(path))]
    digests = [digest(read_bytes(file, MAX_FILE_BYTES)) if is_file(file) else "" for file in files]

    def make() -> Arrays:
        return rock_arrays(import_mesh(path))

    return rock_of(cached(store, "rocks", make, code=__name__, inputs=[path.name, *digests]))


def _upright(mesh: FileMesh, turn: Floats, height_m: float, notes: list[str]) -> FileMesh:
    turned = mesh.values[:, :3] @ turn.T
    extents = np.ptp(turned, axis=0)
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(turned.T)), 0))
    if spread[0] < 1e-4 * spread[2] or extents[2] < 1e-4 * extents.max():
        raise UnusableMesh("is flat; a rock needs three dimensions")
    placed, scale = meshes.rest_on_ground(turned, height_m)
    notes.append(f"scaled by {scale:.6g} to {height_m:g} m height and set on the ground")
    reach_m = float(np.linalg.norm(placed - (0, 0, height_m / 2), axis=1).max())
    if reach_m > MAX_REACH_M:
        raise UnusableMesh(
            f"reaches {reach_m:.1f} m from its centre when {height_m:g} m tall, into the viewpoints 3.5 m away; choose another "
            "up axis or a smaller height, or cut off what is no part of the object"
            + "".join(f"; it has {note}" for note in notes if " bodies, " in note)
        )
    sideways_m = float(np.abs(placed[:, :2]).max())
    if sideways_m > 1.5:
        notes.append(
            f"reaches {sideways_m:.2f} m sideways, beyond the evaluation's default crop of 1.5 m: what lies beyond is not measured"
        )
        fits_m = np.floor(150.0 * height_m / sideways_m) / 100.0
        if fits_m >= LOWEST_M:
            notes[-1] += f"; with a height of {fits_m:g} m all of it is inside"
    return replace(mesh, values=np.hstack([placed, mesh.values[:, 3:]]))


def _clean(mesh: FileMesh, number: int | None, notes: list[str]) -> FileMesh:
    """Put duplicate vertices in one place, drop collapsed and repeated faces and the other bodies, turn bodies outward."""
    values, faces = mesh.values, mesh.faces
    low, size = values[:, :3].min(axis=0), float(np.ptp(values[:, :3], axis=0).max())
    if size <= 0:
        raise UnusableMesh("has no extent: all vertices coincide")
    keys = np.round((values[:, :3] - low) / (1e-6 * size)).astype(np.int64)
    _, first, merged = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    merged = merged.reshape(-1)
    body = trimesh.Trimesh(values[first, :3], merged[faces], process=False)
    values[:, :3] = body.vertices[merged]
    good = body.unique_faces() & (body.faces != np.roll(body.faces, 1, axis=1)).all(axis=1)
    if not good.all():
        notes.append(f"dropped {int((~good).sum())} collapsed or repeated faces")
    if body.area_faces[good].sum() <= 1e-12 * size * size:
        raise UnusableMesh("has no surface: all its faces have zero area")
    labels = _bodies(body.vertices, body.faces[good], notes)
    if number is not None:
        if number > labels.max() + 1:
            raise UnusableMesh(f"has no body {number}; it has {labels.max() + 1}")
        notes.append(f"took body {number}")
        good[np.flatnonzero(good)[labels != number - 1]] = False
        labels = np.zeros(int(good.sum()), dtype=np.int64)
    body.update_faces(good)
    body.remove_unreferenced_vertices()
    _check_step(mesh.step, body.vertices, notes)
    if not body.is_watertight:
        notes.append("not watertight")
    wound = body.faces.copy()
    if not body.is_winding_consistent:
        trimesh.repair.fix_winding(body)
    areas = np.maximum(np.bincount(labels, weights=body.area_faces), 1e-300)
    centers = [np.bincount(labels, weights=body.area_faces * x) / areas for x in body.triangles_center.T]
    a, b, c = (body.triangles - np.stack(centers, axis=1)[labels][:, None]).transpose(1, 0, 2)
    volumes = np.bincount(labels, weights=np.einsum("ij,ij->i", a, np.cross(b, c)))
    inward = volumes[labels] < 0  # of bodies, which may have holes
    if inward.any():
        body.faces = np.where(inward[:, None], body.faces[:, ::-1], body.faces)
    faces = faces[good]
    turned = (body.faces != wound).any(axis=1)
    if turned.any():
        notes.append(f"turned {turned.sum()} faces that were inside out or wound against their neighbours")
    faces = np.where(turned[:, None], faces[:, ::-1], faces)
    values, faces = meshes.drop_unused_vertices(values, faces)
    return replace(mesh, values=values, faces=faces)


def _bodies(vertices: Floats, faces: Ints, notes: list[str]) -> Ints:
    """(F,) the body of each face, 0 the one of most surface; ``notes`` lists them where there are several."""
    labels = meshes.body_labels(faces)
    areas = np.bincount(labels, weights=meshes.face_areas(vertices, faces))
    order = np.argsort(-areas, kind="stable")
    labels = np.argsort(order)[labels]
    if len(order) > 1:
        listed = []
        for k in range(min(len(order), MAX_LISTED)):
            size = " x ".join(f"{x:.3g}" for x in np.ptp(vertices[faces[labels == k]].reshape(-1, 3), axis=0))
            listed.append(f"{k + 1}: {size}, {100 * areas[order[k]] / areas.sum():.1f} %")
        more = f"; and {len(order) - MAX_LISTED} smaller ones" if len(order) > MAX_LISTED else ""
        notes.append(
            f"{len(order)} bodies, together the target (--body N takes one), with size in the file's unit and share of the "
            f"surface: {'; '.join(listed)}{more}"
        )
    return labels


def _check_step(step: float, vertices: Floats, notes: list[str]) -> None:
    """Tell of coordinates that were rounded; raise where it matters and is because they are far from the origin."""
    size = float(np.ptp(vertices, axis=0).max())
    steps = f"coordinates in steps of {step:.3g}, {100 * step / size:.2g} % of its size"
    if step > MAX_STEP * size and np.abs(vertices).max() > FAR * size:
        raise UnusableMesh(
            f"has {steps}: they were rounded so far from the origin, as single precision does it (OBJ is read in it); "
            "subtract an offset before you export, or export PLY in double precision"
        )
    if step > 0.05 * MAX_STEP * size:
        notes.append(f"has {steps}")


def _own_colors(mesh: FileMesh, values: Floats, spacing_m: float, notes: list[str]) -> Floats | None:
    """(V, 3) linear colours of the subdivided mesh's vertices ``spacing_m`` apart; None if nothing has a colour."""
    kinds, colors = values[:, 8].astype(int), values[:, 3:6].copy()
    for index, image in enumerate(mesh.textures):
        faces = mesh.faces[mesh.values[mesh.faces[:, 0], 8] == index]
        if len(faces):
            corner_uv = mesh.values[faces][..., 6:8]
            area_m2 = float(meshes.face_areas(mesh.values[:, :3], faces).sum())
            shrunk = shrink(fill_gutters(image, corner_uv), spacing_m / texel_side(image, corner_uv, area_m2))
            colors[kinds == index] *= sample(shrunk, values[kinds == index, 6:8])
    known = np.isfinite(colors).all(axis=1)
    if not known.any():
        return None
    if not known.all():
        notes.append(
            f"{100 * (~known).mean():.0f} % of the surface has no colour of its own: it gets the mean"
        )
        colors[~known] = colors[known].mean(axis=0)
    return np.clip(colors, 0.0, 1.0)
