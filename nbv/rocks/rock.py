"""A rock: a triangle mesh in the world frame with an albedo per vertex."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any, Literal, get_args

import lazy_loader
import numpy as np

from nbv.cache import Arrays
from nbv.types import Floats, Floats32, Ints

trimesh: Any = lazy_loader.load("trimesh")  # half a second, and most commands describe no rock
Split = Literal["train", "validation", "held-out", "extra"]
SPLITS: tuple[Split, ...] = get_args(Split)
RockSource = Literal["procedural", "imported", "photographs"]

DEFAULT_HEIGHT_M = 1.6
CONTACT_BAND_M = 0.02  # faces this close to the ground count as touching it, not as overhanging
OVERHANG_ANGLE_DEG = 10.0  # how far past the vertical a face must lean to count as an overhang
_MESH = ("vertices_m", "faces", "albedo")
_TEXTS = ("name", "split", "difficulty", "sha256")


@dataclass(frozen=True, eq=False)
class Rock:
    """Ground truth of one target; what is rendered and what reconstructions are measured against.

    The world frame is ENU in metres. The rock rests on the ground, z = 0, and its bounding box is
    centred on the origin horizontally, so at the default height its centre is (0, 0, 0.8).
    """

    name: str
    vertices_m: Floats  # (V, 3)
    faces: Ints  # (F, 3), counter-clockwise seen from outside
    albedo: Floats32  # (V, 3) linear reflectance, 0 to 1
    split: Split
    difficulty: str  # what makes the rock easy or hard, in a phrase
    sha256: str  # of geometry and albedo, see `content_hash`
    notes: tuple[str, ...] = ()  # what an importer changed


@dataclass(frozen=True)
class RockInfo:
    """One line of the catalogue."""

    name: str
    split: Split
    source: RockSource
    difficulty: str


def content_hash(vertices_m: Floats, faces: Ints, albedo: Floats32) -> str:
    """SHA-256 of geometry and albedo, on values rounded to 1 micrometre and 1e-4.

    Rounding keeps the last bits of a floating-point library out of a rock's identity.
    """
    digest = hashlib.sha256()
    for array in (
        np.round(np.asarray(vertices_m, dtype=np.float64) * 1e6).astype("<i8"),
        np.asarray(faces).astype("<i8"),
        np.round(np.asarray(albedo, dtype=np.float64) * 1e4).astype("<i4"),
    ):
        digest.update(str(array.shape).encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def make_rock(
    name: str,
    vertices_m: Floats,
    faces: Ints,
    albedo: Floats32,
    *,
    split: Split,
    difficulty: str,
    notes: tuple[str, ...] = (),
) -> Rock:
    """A `Rock` with its content hash; albedo is clipped to 0..1, and arrays are made read-only, since rocks are shared."""
    vertices_m = np.ascontiguousarray(vertices_m, dtype=np.float64)
    faces = np.ascontiguousarray(faces, dtype=np.int64)
    albedo = np.ascontiguousarray(np.clip(albedo, 0.0, 1.0), dtype=np.float32)
    sha256 = content_hash(vertices_m, faces, albedo)
    for array in (vertices_m, faces, albedo):
        array.setflags(write=False)
    return Rock(name, vertices_m, faces, albedo, split, difficulty, sha256, notes)


def rock_arrays(rock: Rock) -> Arrays:
    """A rock as the arrays of a file."""
    arrays = {name: np.asarray(getattr(rock, name)) for name in (*_MESH, *_TEXTS)}
    return arrays | {"faces": rock.faces.astype(np.int32), "notes": np.array(rock.notes, dtype=np.str_)}


def rock_of(arrays: Arrays) -> Rock:
    """The rock of `rock_arrays`."""
    mesh: dict[str, Any] = {name: arrays[name] for name in _MESH}
    mesh["faces"] = mesh["faces"].astype(np.int64)
    for array in mesh.values():
        array.setflags(write=False)
    texts: dict[str, Any] = {name: str(arrays[name]) for name in _TEXTS}
    return Rock(**mesh, **texts, notes=tuple(arrays["notes"].tolist()))


def overhanging_share(mesh: Any) -> float:
    """Share of the area of a trimesh mesh on the ground that leans over by more than 10 degrees, clear of the ground."""
    leaning = mesh.face_normals[:, 2] < -np.sin(np.deg2rad(OVERHANG_ANGLE_DEG))
    clear = mesh.triangles_center[:, 2] > CONTACT_BAND_M
    return float(mesh.area_faces[leaning & clear].sum() / mesh.area)


def describe(rock: Rock) -> dict[str, Any]:
    """Facts about the rock's shape and albedo, which `gatetune rocks show` prints."""
    mesh = trimesh.Trimesh(rock.vertices_m, rock.faces, process=False)
    faces_at_edge = np.bincount(mesh.edges_unique_inverse)
    boundary = int((faces_at_edge == 1).sum())
    grey = rock.albedo.mean(1)
    return {
        "extents_m": tuple(mesh.extents.tolist()),
        "vertices": len(rock.vertices_m),
        "faces": len(rock.faces),
        "mean_edge_m": float(mesh.edges_unique_length.mean()),
        "area_m2": float(mesh.area),
        "volume_m3": float(mesh.volume) if boundary == 0 else None,
        "boundary_edges": boundary,  # with one face
        "non_manifold_edges": int((faces_at_edge > 2).sum()),  # with three faces or more
        "overhang_fraction": overhanging_share(mesh),
        "mean_albedo": tuple(rock.albedo.mean(0).tolist()),
        "albedo_contrast": float(grey.std() / max(float(grey.mean()), 1e-9)),
    }
