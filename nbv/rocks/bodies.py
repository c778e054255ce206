"""Which bodies of a mesh file are the object: not what it stands on or before, nor specks, nor what lies inside it or far away."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nbv.geometry.mesh import weighted_normals
from nbv.types import Bools, Floats, Ints

SPECK = 0.01  # of the surface
CRUMBLED = 0.1  # of the surface: where specks are more than this, the object itself is in pieces
NEAR = 0.5  # of the object's size: bodies with a wider gap to it are others
WIDER, LOW = 1.05, 0.2  # a support against what it carries: its width, at least; the other's depth, at least
LOOKED_AT = 32  # bodies, the largest, that may be supports or hidden
_SAMPLES = 2000  # of a body's surface


def kept_bodies(vertices: Floats, faces: Ints, labels: Ints, keep: str, notes: list[str]) -> Bools:
    """(B,) which bodies are kept, of faces with ``labels`` in an upright frame; ``notes`` gets what is left out, and how large it is."""
    normals = weighted_normals(vertices, faces)
    areas = np.bincount(labels, weights=np.linalg.norm(normals, axis=1))
    shares = areas / areas.sum()
    largest = np.argsort(-areas, kind="stable")
    kept = np.zeros(len(areas), dtype=bool)
    if keep != "auto":
        kept[largest[: {"all": len(areas), "largest": 1}.get(keep) or int(keep)]] = True
        if not kept.all():
            notes.append(f"kept {_counted(kept, shares)} as asked; dropped {_counted(~kept, shares)}")
        return kept
    if len(areas) == 1:
        return ~kept
    order = np.argsort(labels, kind="stable")
    starts = np.searchsorted(labels[order], np.arange(len(areas)))
    low = np.minimum.reduceat(vertices[faces].min(axis=1)[order], starts)
    high = np.maximum.reduceat(vertices[faces].max(axis=1)[order], starts)
    looked = [
        _Body(vertices, faces[labels == b], normals[labels == b], low[b], high[b])
        for b in largest[:LOOKED_AT]
    ]
    kept[:] = True
    for k, kind in _supports(looked, areas[largest[:LOOKED_AT]]):
        b = largest[k]
        kept[b] = False
        size = " x ".join(f"{x:.3g}" for x in high[b] - low[b])
        notes.append(
            f"left out {kind}, {size} in the file's unit, {100 * shares[b]:.1f} % of the surface; "
            "--keep all keeps it"
        )
    small = kept & (areas < SPECK * areas[kept].sum())
    if areas[small].sum() > CRUMBLED * areas[kept].sum():
        small[:] = False
    far = kept & ~_near(low, high, kept & ~small, int(np.argmax(areas * kept)))
    inside = np.zeros_like(kept)
    around = [k for k, b in enumerate(largest[:LOOKED_AT]) if kept[b] and not small[b] and not far[b]]
    for k in around:
        inside[largest[k]] = any(looked[k].lies_inside(looked[other]) for other in around if other < k)
    for dropped, reason in (
        (far, "out of reach"),
        (small & ~far, "under 1 % of the surface each"),
        (inside, "inside others"),
    ):
        kept &= ~dropped
        if dropped.any():
            sizes = (high - low)[dropped].max(axis=1)
            size = f"{sizes.max():.3g} in the file's unit" + (", the largest" if len(sizes) > 1 else "")
            notes.append(f"dropped {_counted(dropped, shares)}, {size}: {reason}; --keep all keeps them")
    if kept.sum() > 1:
        notes.append(f"kept {_counted(kept, shares)}, as one object; --keep largest keeps one")
    return kept


def _counted(which: Bools, shares: Floats) -> str:
    count = int(which.sum())
    return f"{count} {'body' if count == 1 else 'bodies'} ({100 * shares[which].sum():.1f} % of the surface)"


def _near(low: Floats, high: Floats, counts: Bools, first: int) -> Bools:
    """(B,) bodies whose bounding box is near that of the object, which grows from its ``first`` by those that count."""
    near = np.arange(len(low)) == first
    while True:
        bottom, top = low[near & counts].min(axis=0), high[near & counts].max(axis=0)
        gap = np.linalg.norm(np.maximum(0, np.maximum(low - top, bottom - high)), axis=1)
        grown = near | (gap <= NEAR * (top - bottom).max())
        if (grown == near).all() or (grown & counts == near & counts).all():
            return np.asarray(grown)
        near = grown


class _Body:
    """One body: samples of its surface at equal areas, and its flat sides."""

    def __init__(self, vertices: Floats, faces: Ints, normals: Floats, low: Floats, high: Floats) -> None:
        self.triangles = vertices[faces]  # (F, 3, 3)
        self.low, self.high = low, high
        lengths = np.linalg.norm(normals, axis=1)
        self.area = lengths.sum() / 2
        steps = (np.arange(_SAMPLES) + 0.5) / _SAMPLES * lengths.sum()
        self.sampled = np.minimum(np.searchsorted(np.cumsum(lengths), steps), len(faces) - 1)
        self.normals = normals[self.sampled] / np.maximum(lengths[self.sampled], 1e-300)[:, None]
        self.centers = self.triangles[self.sampled].mean(axis=1)
        self.points = self.triangles.reshape(-1, 3)[:: max(1, 3 * len(faces) // 1000)]

    def carries(self, others: Sequence[_Body]) -> tuple[Bools, str]:
        """Which of ``others`` lie on or before a flat side of this body that is wider than they; and what the body then is."""
        carried, kind = np.zeros(len(others), dtype=bool), ""
        left = np.ones(_SAMPLES, dtype=bool)
        for _ in range(4):  # directions of flat sides, from the one of most surface
            if left.mean() < 0.1:
                break
            tried = self.normals[left][:: max(1, left.sum() // 32)]
            axis = tried[(np.abs(self.normals[left] @ tried.T) > 0.95).sum(axis=0).argmax()]
            along = self.normals @ axis
            axis = (self.normals * np.sign(along)[:, None])[left & (np.abs(along) > 0.95)].sum(axis=0)
            axis /= np.linalg.norm(axis)
            flat = np.abs(self.normals @ axis) > 0.9
            left &= ~flat
            for out in (axis, -axis):
                if out[2] > -0.5 and (before := self._before(out, flat, others)).sum() > carried.sum():
                    carried, depth = before, np.ptp(self.points @ out)
                    thin = depth < 0.25 * np.ptp(self.points, axis=0).max()
                    kind = "a wall" if out[2] < 0.7 else "the ground" if thin else "a plinth"
        return carried, kind

    def _before(self, out: Floats, flat: Bools, others: Sequence[_Body]) -> Bools:
        """Which of ``others`` lie before the outermost flat side in direction ``out`` and are narrower than it."""
        before = np.zeros(len(others), dtype=bool)
        at = self.centers @ out
        side = float(np.quantile(at[flat], 0.95))
        tolerance = 0.05 * float((self.high - self.low).max())
        patch = flat & (np.abs(at - side) <= tolerance)
        corners = self.triangles[np.unique(self.sampled[patch])].reshape(-1, 3)
        across = _across(out, corners)
        spread = np.ptp(corners @ across, axis=0)
        if patch.mean() * self.area < 0.5 * spread.prod():  # a rim, or single faces
            return before
        middle = (corners @ across).min(axis=0) + spread / 2
        for k, other in enumerate(others):
            depth, width = np.ptp(other.points @ out), np.ptp(other.points @ across, axis=0)
            center = (other.points @ across).min(axis=0) + width / 2
            before[k] = (
                other is not self
                and (other.points @ out > side - min(tolerance, 0.1 * depth)).mean() > 0.6
                and (spread >= WIDER * width).all()
                and (np.abs(center - middle) <= (spread - 0.9 * width) / 2).all()
                and depth >= LOW * np.ptp(self.points @ out)
            )
        return before

    def lies_inside(self, other: _Body) -> bool:
        """Whether points of this body see the other all around them."""
        if (self.low < other.low).any() or (self.high > other.high).any():
            return False
        for point in self.points[:: max(1, len(self.points) // 8)]:
            a, b, c = (other.triangles - point).transpose(1, 0, 2)
            x, y, z = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
            volume = np.einsum("ij,ij->i", a, np.cross(b, c))
            edges = x * y * z + (a * b).sum(1) * z + (b * c).sum(1) * x + (c * a).sum(1) * y
            if abs(np.arctan2(volume, edges).sum() / (2 * np.pi)) < 0.5:  # solid angle over 4 pi
                return False
        return True


def _across(out: Floats, points: Floats) -> Floats:
    """(3, 2) directions at right angles to ``out`` and to each other in which the points need the smallest rectangle."""
    first = np.cross(out, np.eye(3)[np.abs(out).argmin()])
    first /= np.linalg.norm(first)
    second = np.cross(out, first)
    turns = np.deg2rad(np.arange(0, 90, 5))
    choices = [
        np.stack([np.cos(t) * first + np.sin(t) * second, np.cos(t) * second - np.sin(t) * first], axis=1)
        for t in turns
    ]
    return min(choices, key=lambda across: np.ptp(points @ across, axis=0).prod())


def _supports(bodies: Sequence[_Body], areas: NDArray[Any]) -> list[tuple[int, str]]:
    """Bodies on or before which the largest that is no support stands, by index, and what they are."""
    loads = [body.carries(bodies) for body in bodies]
    supports = np.array([carried.any() for carried, _ in loads])
    if supports.all() or not supports.any():
        return []
    others = ~supports & (areas >= SPECK * areas.max(where=~supports, initial=0))
    low, high = (np.array([getattr(body, end) for body in bodies]) for end in ("low", "high"))
    others &= _near(low, high, others, int(others.argmax()))  # the largest and what belongs to it
    return [(k, kind) for k, (carried, kind) in enumerate(loads) if supports[k] and carried[others].all()]
