"""Where the object is, which way is up and how large it is: from a sparse model to a frame for the dense stage, and on to the set's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from nbv.errors import UserError
from nbv.geometry.frames import Similarity
from nbv.geometry.target import GROUND_BAND_M, find_target
from nbv.geometry.visibility import without_isolated
from nbv.photographs.import_source import ImportSource
from nbv.photographs.photograph_set import MEDIAN_DISTANCE_M
from nbv.photographs.sparse_model import SolvedModel
from nbv.types import Bools, Floats

LEVEL_DEG = 15.0  # a photograph is held level to within this, or is left out of what is up
LOOKS_AT_DEG = 30.0  # off its optical axis at most lies what a photograph is of
MIN_LOOKING = 0.6  # share of the photographs that look at one place
IN_MASK = 0.8  # share of a point's observations that lie in masks where it is the object's
MIN_POINTS = 50
# By which more of what the cameras look at lies in the masks than of what is farther away.
MASK_CONTRAST = 0.05
BESIDE = 1.6  # the ground is seen to so many half widths of the object from its middle
GROUND_SHARE = 0.3  # of the points beside the object that lie in one band where there is ground
BOX_MARGIN = 0.05  # about the object's box, as a share of its largest side
ISOLATED_M = 0.1  # a point without two others so near is taken for a wrong match
_ROUNDS = 30


@dataclass(frozen=True)
class ObjectFrame:
    """What `find_object` found: a frame with z up whose origin the cameras look at, the median camera at 3.5 from it."""

    frame_from_model: Similarity
    low_m: Floats  # (3,) of the object's box in that frame
    high_m: Floats  # (3,)
    notes: tuple[str, ...]
    # The box stands on ground that was seen; else it begins where the object is seen to.
    grounded: bool = True
    masked: bool = False  # every photograph with a pose has a mask

    @property
    def half_width_m(self) -> float:
        """Half the side of the smallest cube about the box's centre that holds it."""
        return float((self.high_m - self.low_m).max() / 2)

    @property
    def center_m(self) -> Floats:
        """(3,) middle of the box."""
        return (self.low_m + self.high_m) / 2

    def in_box(self, points_m: Floats) -> Bools:
        """(N,) which of points (N, 3) lie in the object's box or a little beyond."""
        margin = BOX_MARGIN * float((self.high_m - self.low_m).max())
        inside: Bools = np.all((points_m >= self.low_m - margin) & (points_m <= self.high_m + margin), axis=1)
        return inside


def find_object(model: SolvedModel, source: ImportSource) -> ObjectFrame:
    """A frame from where the cameras look and how they are held, and the box of what rises from the ground there.

    ``model`` is in its own frame. Masks mark the object; photographs without one say nothing of it where others have one. `UserError` where the cameras look at no common place, or the masks are
    white or black everywhere, inverted, or of another size.
    """
    center = _gaze_point(model)
    gaze = center - model.centers
    distances = np.linalg.norm(gaze, axis=1)
    off_axis_deg = np.rad2deg(np.arccos(np.clip((gaze * model.axes).sum(1) / distances, -1, 1)))
    looking = float(np.mean(off_axis_deg <= LOOKS_AT_DEG))
    if looking < MIN_LOOKING:
        raise UserError(
            f"only {100 * looking:.0f} % of the photographs look at one place: are there two objects? "
            "put the photographs of each into a folder of its own"
        )
    up, word = _up(model, np.array([source.up(name) for name in model.names]))
    notes = [f"up: {word}"]
    # Up is z, and the first camera stands in the direction of x.
    turn = Rotation.align_vectors(np.eye(3)[[2, 0]], [up, model.centers[0] - center], weights=[np.inf, 1])[0]
    rotation = turn.as_matrix()
    scale = MEDIAN_DISTANCE_M / float(np.median(distances))
    frame_from_model = Similarity(scale, rotation, -scale * rotation @ center)
    in_object = _in_object(model, source, center) if source.masks else None
    low, high, grounded, word = _box(model.moved(frame_from_model), in_object)
    count, total = sum(name in source.masks for name in model.names), len(model.names)
    if 0 < count < total:
        notes.append(f"masks for {count} of {total} photographs")
    notes.append(f"object: {word}")
    return ObjectFrame(frame_from_model, low, high, tuple(notes), grounded, masked=count == total)


def placement(low: Floats, high: Floats, cameras: Floats) -> Similarity:
    """To the set's frame: the shift and scale that put a box (3,), (3,) on the ground about the origin, the median camera at 3.5 from its centre."""
    center = (low + high) / 2
    scale = MEDIAN_DISTANCE_M / float(np.median(np.linalg.norm(cameras - center, axis=1)))
    return Similarity(scale, np.eye(3), -scale * np.array([center[0], center[1], low[2]]))


def _gaze_point(model: SolvedModel) -> Floats:
    """(3,) the point nearest to the optical axes, in the sum of distances (iteratively reweighted least squares)."""
    across = np.eye(3) - model.axes[:, :, None] * model.axes[:, None, :]  # (M, 3, 3) off the axis
    weights = np.ones(len(model.axes))
    point = np.zeros(3)
    for _ in range(_ROUNDS):
        left = np.einsum("m,mij->ij", weights, across)
        point = np.linalg.lstsq(left, np.einsum("m,mij,mj->i", weights, across, model.centers), rcond=None)[0]
        away = np.linalg.norm(np.einsum("mij,mj->mi", across, point - model.centers), axis=1)
        weights = 1 / np.maximum(away, 1e-3 * np.median(np.linalg.norm(model.centers - point, axis=1)))
    return point


def _up(model: SolvedModel, up_in_picture: Floats) -> tuple[Floats, str]:
    """(3,) up in the model's frame: across the horizontal axes of level photographs, else the mean of their up directions."""
    right, down = model.poses[:, 0, :3], model.poses[:, 1, :3]
    x, y = up_in_picture[:, :1], up_in_picture[:, 1:]
    mean = (x * right + y * down).mean(axis=0)
    mean /= np.linalg.norm(mean)
    sides = -y * right + x * down
    level, inliers = mean, np.ones(len(sides), dtype=bool)
    for _ in range(5):
        spread, axes = np.linalg.eigh(sides[inliers].T @ sides[inliers])
        if spread[1] < 4 * spread[0]:
            break
        level = axes[:, 0] * np.sign(axes[:, 0] @ mean)
        inliers = np.abs(sides @ level) < np.sin(np.deg2rad(LEVEL_DEG))
        if inliers.mean() < 0.5:
            break
    else:
        if level @ mean > 0.5:
            rest = np.rad2deg(np.arcsin(np.sqrt(np.mean((sides[inliers] @ level) ** 2))))
            return level, f"photographs are held level to {rest:.1f}° rms"
    return mean, "the mean of the photographs' ups, since they are not held level"


def _box(model: SolvedModel, share: Floats | None) -> tuple[Floats, Floats, bool, str]:
    """Corners (3,), (3,) of the object's box in the model's frame, whether it stands on ground, and how it was found.

    ``share`` (N,) as `_in_object` gives it, where there are masks.
    """
    points = model.xyz
    if share is not None:
        members = without_isolated(points[share >= IN_MASK], ISOLATED_M)
        if len(members) < MIN_POINTS:
            raise UserError(
                f"only {len(members)} points of the model lie inside the masks; are they of these photographs, and white "
                "on the object?"
            )
        low, high = np.percentile(members, [0.5, 99.5], axis=0)
        ground = _ground_beside(points[share < 1 - IN_MASK], low, high)
        word = "it stands on the ground seen beside it"
        if ground is None:
            word = "no ground is seen beside it, it is measured from its lowest point"
        low[2] = low[2] if ground is None else ground
        return low, high, ground is not None, f"{len(members)} sparse points inside the masks; {word}"
    if (target := find_target(points, np.zeros(3), model.centers)) is not None:
        near = (np.abs(points[:, :2] - target.center_m[:2]) <= 1.1 * target.half_extent_m).all(axis=1)
        height = points[:, 2] - target.ground_m
        above = (height > GROUND_BAND_M) & (height < 2.2 * target.half_extent_m)
        members = without_isolated(points[near & above], ISOLATED_M)
        if len(members) >= MIN_POINTS:
            low, high = np.percentile(members, [0.5, 99.5], axis=0)
            low[2] = target.ground_m
            word = f"{len(members)} sparse points that rise from the ground where the cameras look"
            return low, high, True, word
    members = without_isolated(points[np.linalg.norm(points, axis=1) <= MEDIAN_DISTANCE_M / 2], ISOLATED_M)
    if len(members) < MIN_POINTS:
        raise UserError(
            "hardly a point of the model lies where the cameras look; give masks of the object (--masks)"
        )
    low, high = np.percentile(members, [2.0, 98.0], axis=0)
    return low, high, True, "nothing rises from the ground where the cameras look: all that is near there"


def _ground_beside(points: Floats, low: Floats, high: Floats) -> float | None:
    """Height on which a box (3,), (3,) stands: where most of the points (N, 3) beside it lie, none of which is its own."""
    half = float((high - low)[:2].max()) / 2
    beside = points[np.linalg.norm(points[:, :2] - ((low + high) / 2)[:2], axis=1) <= BESIDE * half]
    beside = beside[beside[:, 2] <= low[2] + 0.1 * (high - low)[2]]
    if len(beside) < MIN_POINTS:
        return None
    heights = np.sort(beside[:, 2])
    ends = np.searchsorted(heights, heights + GROUND_BAND_M, side="right")
    first = int(np.argmax(ends - np.arange(len(heights))))
    band = heights[first : ends[first]]
    return float(np.median(band)) if len(band) >= GROUND_SHARE * len(heights) else None


def _in_object(model: SolvedModel, source: ImportSource, center: Floats) -> Floats:
    """(N,) share of each point's observations in masks that lies on the object, near ``center`` (3,); NaN without any. Errors as `find_object`."""
    inside, masked, white = np.zeros(len(model.views), dtype=bool), np.zeros(len(model.views), dtype=bool), []
    for view, name in enumerate(model.names):
        if (mask := source.mask(name)) is not None:
            members, pixels = model.of_view(view)
            inside[members], masked[members] = mask[pixels], True
            white.append(mask.mean())
    folder = next(iter(source.masks.values())).parent
    if set(white) in ({0.0}, {1.0}):
        raise UserError(
            f"the masks in {folder} are {'white' if white[0] else 'black'} everywhere; make them white on the object and "
            "black beside it"
        )
    away = np.linalg.norm(model.xyz - center, axis=1)[model.points]
    near = away <= np.median(away[masked])
    if inside[masked & near].mean() < inside[masked & ~near].mean() - MASK_CONTRAST:
        raise UserError(
            f"the masks in {folder} are black where the cameras look and white around it; invert them: white is the object"
        )
    seen, on_object = (np.bincount(model.points[of], minlength=len(model.xyz)) for of in (masked, inside))
    return np.where(seen, on_object / np.maximum(seen, 1), np.nan)
