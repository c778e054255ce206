"""A rock: a triangle mesh in the world frame with an albedo per vertex."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from nbv.rocks.mesh import edge_face_counts, face_areas, face_normals, signed_volume
from nbv.types import Floats, Floats32, Ints

Split = Literal["train", "validation", "held-out", "extra"]
SPLITS: tuple[Split, ...] = get_args(Split)
RockSource = Literal["procedural", "imported", "photographs"]

DEFAULT_HEIGHT_M = 1.6
CONTACT_BAND_M = 0.02  # faces this close to the ground count as touching it, not as overhanging
OVERHANG_ANGLE_DEG = 10.0  # how far past the vertical a face must lean to count as an overhang


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


@dataclass(frozen=True)
class RockFacts:
    """What is measured of a rock; `gatetune rocks show` prints it."""

    extents_m: tuple[float, float, float]
    vertices: int
    faces: int
    mean_edge_m: float
    area_m2: float
    volume_m3: float | None  # None unless watertight
    boundary_edges: int  # edges with one face
    non_manifold_edges: int  # edges with three or more faces
    overhang_fraction: float  # of the area: leaning over by more than 10 degrees, clear of the ground
    mean_albedo: tuple[float, float, float]
    albedo_contrast: float  # standard deviation / mean of the grey albedo


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


def overhanging_share(vertices_m: Floats, faces: Ints) -> float:
    """Share of the area of a mesh on the ground that leans over by more than 10 degrees, clear of the ground."""
    areas = face_areas(vertices_m, faces)
    leaning = face_normals(vertices_m, faces)[:, 2] < -np.sin(np.deg2rad(OVERHANG_ANGLE_DEG))
    clear = vertices_m[faces][:, :, 2].mean(1) > CONTACT_BAND_M
    return float(areas[leaning & clear].sum() / areas.sum())


def describe(rock: Rock) -> RockFacts:
    """Facts about the rock's shape and albedo."""
    corners = rock.vertices_m[rock.faces]
    counts = edge_face_counts(rock.faces)
    boundary, non_manifold = int((counts == 1).sum()), int((counts > 2).sum())
    extents = rock.vertices_m.max(0) - rock.vertices_m.min(0)
    grey = rock.albedo.mean(1)
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    return RockFacts(
        extents_m=(float(extents[0]), float(extents[1]), float(extents[2])),
        vertices=len(rock.vertices_m),
        faces=len(rock.faces),
        mean_edge_m=float(edges.mean()),
        area_m2=float(face_areas(rock.vertices_m, rock.faces).sum()),
        volume_m3=float(signed_volume(rock.vertices_m, rock.faces)) if boundary == 0 else None,
        boundary_edges=boundary,
        non_manifold_edges=non_manifold,
        overhang_fraction=overhanging_share(rock.vertices_m, rock.faces),
        mean_albedo=tuple(float(c) for c in rock.albedo.mean(0)),  # type: ignore[arg-type]
        albedo_contrast=float(grey.std() / max(float(grey.mean()), 1e-9)),
    )
