"""Any mesh that trimesh reads, made into a rock: one body, upright, 1.6 m tall, resting on the ground."""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from nbv.errors import UserError
from nbv.rocks import mesh as meshes
from nbv.rocks.albedo import procedural_albedo
from nbv.rocks.rock import DEFAULT_HEIGHT_M, SPLITS, Rock, Split, make_rock
from nbv.rocks.texture import (
    Linear,
    fill_gutters,
    linear_from_srgb,
    linear_image,
    open_texture,
    sample,
    shrink,
    triplanar,
)
from nbv.types import Floats, Ints

Up = Literal["auto", "x", "y", "z", "-x", "-y", "-z"]

MAX_FACES = 5_000_000
MAX_FILE_BYTES = 2 * 1024**3
MAX_EDGE_M = 0.009  # longest edge after subdivision; the mean comes out below 6 mm
MAX_FINE_FACES = 3_000_000  # beyond this the subdivision is coarser
MAX_REACH_M = 3.0  # viewpoints fly 3.5 m from the target
TILE_M = 1.6  # one tile of a triplanar albedo image

_UP = {
    "x": np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]], dtype=float),
    "-x": np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], dtype=float),
    "y": np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], dtype=float),
    "-y": np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], dtype=float),
    "z": np.eye(3),
    "-z": np.diag([1.0, -1.0, -1.0]),
}


@dataclass
class _Skin:
    """Where the colours of one part of a mesh come from."""

    kind: Literal["texture", "colors", "none"]
    image: Linear | None = None  # linear, for "texture"


@dataclass
class _Soup:
    """Triangles of a whole file in one list, with what their corners carry."""

    vertices: Floats  # (V, 3)
    faces: Ints  # (F, 3)
    skins: list[_Skin]
    skin: Ints  # (F,) index into `skins`
    corner: Floats  # (F, 3, 3): texture coordinates (u, v, -) or a linear colour, by the face's skin


def import_mesh(
    path: str | Path,
    *,
    name: str | None = None,
    height_m: float = DEFAULT_HEIGHT_M,
    split: Split = "train",
    difficulty: str | None = None,
    up: Up = "auto",
    albedo: str | Path | None = None,
    keep: Literal["largest", "all"] = "largest",
) -> Rock:
    """Make a rock of a mesh file (OBJ with MTL and texture, GLB, PLY, STL, ... whatever trimesh reads).

    Duplicate vertices are merged, the body with the largest surface is kept, the mesh is turned upright,
    scaled to ``height_m``, set on the ground and subdivided until no edge is longer than 9 mm, so that
    vertices can carry the texture. Subdivision does not move the surface. Everything done is told in the
    rock's notes.

    Parameters
    ----------
    name
        Default: the file's name in lower case.
    difficulty
        A phrase for the catalogue; default: the overhang, measured.
    up
        The file's upward axis. ``auto`` takes y for glTF, as its standard says, and z for everything else.
    albedo
        None: the mesh's own texture or colours (taken as sRGB), else a procedural albedo.
        ``"procedural"``: always that. A path: an image, projected along the three axes.
    keep
        ``all`` keeps loose bodies too.

    Raises
    ------
    UserError
        The file is missing, unreadable, empty, not a surface, not finite, flat or far too large.
    """
    path = Path(path).expanduser()
    if up != "auto" and up not in _UP:
        raise UserError(f"up is {up!r}; allowed: {', '.join(get_args(Up))}")
    if split not in SPLITS:
        raise UserError(f"split is {split!r}; allowed: {', '.join(SPLITS)}")
    if keep not in ("largest", "all"):
        raise UserError(f"keep is {keep!r}; allowed: largest, all")
    if not 0.1 <= height_m <= 5.0:
        raise UserError(f"height_m is {height_m!r}; it must be between 0.1 and 5 m")
    notes: list[str] = []
    soup = _read(path, notes)
    soup = _clean(soup, path, keep, notes)

    axis = ("y" if path.suffix.lower() in (".glb", ".gltf") else "z") if up == "auto" else up
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
    coarse = len(faces)
    fine_vertices, fine_faces, parent, barycentric = meshes.refine(vertices, faces, max_edge)
    if len(fine_faces) > coarse:
        notes.append(f"subdivided from {coarse} to {len(fine_faces)} faces; the surface is unchanged")

    normals = meshes.vertex_normals(fine_vertices, fine_faces)
    colors = _albedo(
        soup,
        vertices,
        faces,
        fine_vertices,
        fine_faces,
        parent,
        barycentric,
        normals,
        albedo,
        max_edge,
        notes,
    )
    return make_rock(
        name or _default_name(path),
        fine_vertices,
        fine_faces,
        colors,
        split=split,
        difficulty=difficulty or _measured_difficulty(vertices, faces),
        notes=tuple(notes),
    )


def _default_name(path: Path) -> str:
    return re.sub(r"[^a-z0-9_-]+", "-", path.stem.lower()).strip("-_")[:64] or "rock"


def _measured_difficulty(vertices: Floats, faces: Ints) -> str:
    areas, normals = meshes.face_areas(vertices, faces), meshes.face_normals(vertices, faces)
    share = areas[normals[:, 2] < -np.sin(np.deg2rad(10.0))].sum() / areas.sum()
    return f"imported; {100 * share:.0f} % of the surface leans over"


# --- reading -------------------------------------------------------------------------------------------


def _read(path: Path, notes: list[str]) -> _Soup:
    import trimesh  # noqa: PLC0415  half a second to load

    if not path.is_file():
        raise UserError(f"there is no mesh file {str(path)!r}; check the path")
    size = path.stat().st_size
    if size == 0:
        raise UserError(f"mesh file {str(path)!r} is empty")
    if size > MAX_FILE_BYTES:
        raise UserError(f"mesh file {str(path)!r} has {size / 1e9:.1f} GB; decimate it first")
    try:
        scene = trimesh.load_scene(path, process=False)
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
    soup = _Soup(
        np.concatenate(vertices), np.concatenate(faces), skins, np.concatenate(skin), np.concatenate(corner)
    )
    bad = np.any(~np.isfinite(soup.vertices), axis=1)
    if np.any(np.take(bad, soup.faces)):
        raise UserError(
            f"mesh file {str(path)!r} has {int(bad.sum())} vertices that are not finite numbers; "
            "repair or re-export it"
        )
    return soup


def _skin(part: Any, linear_colors: bool, notes: list[str]) -> tuple[_Skin, Floats]:
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
            return _Skin("none"), nothing
        try:
            linear = linear_image(image)
        except (OSError, ValueError, SyntaxError) as error:
            notes.append(f"the texture image cannot be read: {' '.join(str(error).split())[:80]}")
            return _Skin("none"), nothing
        factor = getattr(material, "baseColorFactor", None)
        if factor is not None:
            scale = np.asarray(factor, dtype=np.float32)[:3]
            linear = linear * (scale / np.float32(255) if scale.max() > 1 else scale)
        nothing[..., :2] = np.asarray(uv, dtype=float)[faces]
        return _Skin("texture", linear), nothing
    if kind in ("vertex", "face"):
        raw = part.visual.vertex_colors if kind == "vertex" else part.visual.face_colors
        colors = np.asarray(raw, dtype=float)[:, :3] / 255.0
        if not linear_colors:
            colors = linear_from_srgb(colors).astype(float)
        return _Skin("colors"), colors[faces] if kind == "vertex" else np.repeat(colors[:, None], 3, axis=1)
    return _Skin("none"), nothing


# --- geometry ------------------------------------------------------------------------------------------


def _clean(soup: _Soup, path: Path, keep: str, notes: list[str]) -> _Soup:
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

    if keep == "largest":
        labels = meshes.body_labels(faces[good])
        body_areas = np.bincount(labels, weights=areas[good])
        if len(body_areas) > 1:
            best = int(np.argmax(body_areas))
            share = body_areas[best] / body_areas.sum()
            notes.append(
                f"kept the largest of {len(body_areas)} bodies, {100 * share:.1f} % of the surface"
                + ("" if share > 0.5 else "; if the parts belong together, import with keep all")
            )
            good[np.flatnonzero(good)[labels != best]] = False
    vertices, faces = meshes.drop_unused_vertices(vertices, faces[good])
    return _Soup(vertices, faces, soup.skins, soup.skin[good], soup.corner[good])


def _refuse_flat(soup: _Soup, path: Path) -> None:
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


# --- albedo --------------------------------------------------------------------------------------------


def _albedo(
    soup: _Soup,
    vertices: Floats,
    faces: Ints,
    fine_vertices: Floats,
    fine_faces: Ints,
    parent: Ints,
    barycentric: Floats,
    normals: Floats,
    choice: str | Path | None,
    max_edge: float,
    notes: list[str],
) -> NDArray[np.float32]:
    spacing = 0.6 * max_edge
    if choice is not None and str(choice) != "procedural":
        image = open_texture(Path(choice).expanduser())
        image = shrink(image, spacing / (TILE_M / max(image.shape[:2])))
        notes.append(f"albedo: {Path(choice).name} projected along the three axes")
        return triplanar(image, fine_vertices, normals, TILE_M)
    if choice is None:
        colors = _own_colors(soup, vertices, faces, fine_vertices, fine_faces, parent, barycentric, spacing)
        if colors is not None and colors.std(0).max() > 0.004:
            kinds = {soup.skins[i].kind for i in np.unique(soup.skin)}
            word = "texture" if "texture" in kinds else "vertex or face colours"
            notes.append(f"albedo: the mesh's own {word}, converted from sRGB to linear")
            return colors
        why = "the mesh has no texture or colours" if colors is None else "the mesh has one colour only"
        notes.append(f"albedo: procedural, since {why}")
    else:
        notes.append("albedo: procedural, as asked")
    seed = zlib.crc32(np.round(vertices * 1e4).astype("<i8").tobytes()) & 0xFFFF
    return procedural_albedo(fine_vertices, normals, seed)


def _own_colors(
    soup: _Soup,
    vertices: Floats,
    faces: Ints,
    fine_vertices: Floats,
    fine_faces: Ints,
    parent: Ints,
    barycentric: Floats,
    spacing: float,
) -> NDArray[np.float32] | None:
    """(V, 3) the mean over the faces at each vertex of the colour there; None if nothing has a colour.

    Each face is asked at points drawn a sixth of the way from its corners to its middle: the mean then
    averages the texture around the vertex, and no lookup falls on the far side of a seam.
    """
    total = np.zeros((len(fine_vertices), 3))
    count = np.zeros(len(fine_vertices))
    areas = meshes.face_areas(vertices, faces)
    inset = barycentric + (barycentric.mean(1, keepdims=True) - barycentric) / 6
    for index, skin in enumerate(soup.skins):
        if skin.kind == "none":
            continue
        of_skin = soup.skin == index
        if not of_skin.any():
            continue
        fine = np.flatnonzero(of_skin[parent])
        values = np.einsum("fij,fjk->fik", inset[fine], soup.corner[parent[fine]]).reshape(-1, 3)
        if skin.image is not None:
            corner_uv = soup.corner[of_skin][..., :2]
            image = fill_gutters(skin.image, corner_uv)
            image = shrink(image, spacing / _texel_m(image, corner_uv, areas[of_skin]))
            values = sample(image, values[:, :2]).astype(float)
        ids = fine_faces[fine].reshape(-1)
        for channel in range(3):
            total[:, channel] += np.bincount(ids, weights=values[:, channel], minlength=len(total))
        count += np.bincount(ids, minlength=len(total))
    if not count.any():
        return None
    known = count > 0
    colors = total / np.maximum(count, 1)[:, None]
    colors[~known] = colors[known].mean(0)
    return colors.astype(np.float32)


def _texel_m(image: Linear, corner_uv: Floats, areas: Floats) -> float:
    """Median side of a texel on the surface, in metres, weighted by area."""
    a, b, c = (corner_uv[:, i] for i in range(3))
    ab, ac = b - a, c - a
    texels = 0.5 * np.abs(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]) * image.shape[0] * image.shape[1]
    usable = (texels > 1e-9) & (areas > 0)
    if not usable.any():
        return np.inf
    sides = np.sqrt(areas[usable] / texels[usable])
    order = np.argsort(sides)
    weight = np.cumsum(areas[usable][order])
    return float(sides[order][np.searchsorted(weight, weight[-1] / 2)])
