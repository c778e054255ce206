"""The albedo of an imported rock: the mesh's own, or a procedural one."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from nbv.rocks import mesh as meshes
from nbv.rocks.albedo import procedural_albedo
from nbv.rocks.mesh_file import Soup
from nbv.rocks.texture import Linear, fill_gutters, sample, shrink
from nbv.types import Floats, Floats32, Ints


@dataclass(frozen=True)
class FineMesh:
    """A mesh after subdivision (`nbv.rocks.mesh.refine`)."""

    vertices: Floats  # (V, 3)
    faces: Ints  # (F, 3)
    parent: Ints  # (F,) the face of the coarse mesh that each face is part of
    barycentric: Floats  # (F, 3, 3) of each corner in its parent
    max_edge_m: float  # the longest edge


def imported_albedo(soup: Soup, fine: FineMesh, notes: list[str]) -> Floats32:
    """(V, 3) linear albedo of the fine mesh's vertices; ``notes`` gets where it comes from.

    The colours that the corners of ``soup``, the coarse mesh in metres, carry; a procedural albedo where there are none.
    """
    colors = _own_colors(soup, fine, 0.6 * fine.max_edge_m)
    if colors is not None and colors.std(0).max() > 0.004:
        kinds = {soup.skins[i].kind for i in np.unique(soup.skin)}
        word = "texture" if "texture" in kinds else "vertex or face colours"
        notes.append(f"albedo: the mesh's own {word}, converted from sRGB to linear")
        return colors
    why = "the mesh has no texture or colours" if colors is None else "the mesh has one colour only"
    notes.append(f"albedo: procedural, since {why}")
    seed = zlib.crc32(np.round(soup.vertices * 1e4).astype("<i8").tobytes()) & 0xFFFF
    return procedural_albedo(fine.vertices, meshes.vertex_normals(fine.vertices, fine.faces), seed)


def _own_colors(soup: Soup, fine: FineMesh, spacing: float) -> Floats32 | None:
    """(V, 3) the mean over the faces at each vertex of the colour there; None if nothing has a colour.

    Each face is asked at points drawn a sixth of the way from its corners to its middle: the mean then
    averages the texture around the vertex, and no lookup falls on the far side of a seam.
    """
    total = np.zeros((len(fine.vertices), 3))
    count = np.zeros(len(fine.vertices))
    areas = meshes.face_areas(soup.vertices, soup.faces)
    inset = fine.barycentric + (fine.barycentric.mean(1, keepdims=True) - fine.barycentric) / 6
    for index, skin in enumerate(soup.skins):
        if skin.kind == "none":
            continue
        of_skin = soup.skin == index
        if not of_skin.any():
            continue
        inside = np.flatnonzero(of_skin[fine.parent])
        values = np.einsum("fij,fjk->fik", inset[inside], soup.corner[fine.parent[inside]]).reshape(-1, 3)
        if skin.image is not None:
            corner_uv = soup.corner[of_skin][..., :2]
            image = fill_gutters(skin.image, corner_uv)
            image = shrink(image, spacing / _texel_m(image, corner_uv, areas[of_skin]))
            values = sample(image, values[:, :2]).astype(float)
        ids = fine.faces[inside].reshape(-1)
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
