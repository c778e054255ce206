"""How large the model really is: from the object's height, control points or GPS."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nbv.errors import UserError
from nbv.geometry.frames import align_umeyama
from nbv.photographs.photograph_set import ScaleSource
from nbv.photographs.solved import SolvedModel
from nbv.photographs.source import Source
from nbv.safe_files import expanded, read_text
from nbv.types import Floats

EARTH_M = 6_378_137.0
FEWEST_POINTS = 3
WORST_MISS_DEG = 1.0  # of the rays of one control point
WORST_GPS_SCALE = 0.1  # standard error beyond which GPS does not tell the scale
_MOST_LINES = 20_000

Place = tuple[float, float, float]


@dataclass(frozen=True)
class Scale:
    """What is known of the scale before the object's height in the model is."""

    source: ScaleSource
    height_m: float | None = None  # of the object
    metres_per_model_unit: float | None = None
    up: Floats | None = None  # (3,) in the model's frame
    notes: tuple[str, ...] = ()

    def metres_per_unit(self, units_per_model_unit: float, height_units: float) -> float | None:
        """Metres per unit of the set's frame, or None where nothing says."""
        if self.height_m is not None:
            return self.height_m / height_units
        if self.metres_per_model_unit is not None:
            return self.metres_per_model_unit / units_per_model_unit
        return None


@dataclass(frozen=True)
class ControlPoints:
    """Marks (photograph, x, y in its pixels) by place in local metres, east, north, up."""

    path: Path
    marks: Mapping[Place, Sequence[tuple[str, float, float]]]


def read_control_points(path: Path, source: Source) -> ControlPoints:
    """Marks on these photographs, from a file in OpenDroneMap's ``gcp_list.txt`` format.

    Raises
    ------
    UserError
        It cannot be read, or marks a place outside its photograph.
    """
    path = expanded(path)
    lines = [line.split() for line in read_text(path, 16 * 2**20).splitlines() if line.strip()]
    if not 2 <= len(lines) <= _MOST_LINES:
        raise UserError(f"{path} has {len(lines)} lines; it needs a projection and a line for every mark")
    geographic = re.search(r"longlat|4326|^WGS84$", " ".join(lines[0]), re.IGNORECASE) is not None
    of_file = {p.path.name.lower(): p for p in source.photographs}
    marks: dict[Place, list[tuple[str, float, float]]] = {}
    origin: Place | None = None
    for number, words in enumerate(lines[1:], start=2):
        try:
            x, y, z, x_px, y_px = (float(word) for word in words[:5])
            file = words[5]
        except (ValueError, IndexError) as error:
            raise UserError(f"{path} line {number}: a mark is X Y Z PIXEL_X PIXEL_Y FILE; mend it") from error
        if not np.isfinite([x, y, z, x_px, y_px]).all():
            raise UserError(f"{path} line {number}: every number must be finite")
        if (photograph := of_file.get(file.lower())) is None:
            continue
        sizes = (photograph.size_px, photograph.upright_size_px)  # a mark may be of either way to hold it
        if not any(0 <= x_px <= width and 0 <= y_px <= height for width, height in sizes):
            width, height = sizes[1]
            raise UserError(
                f"{path} marks ({x_px:g}, {y_px:g}) in {file}, which has {width} x {height} px; "
                "give marks in pixels of these photographs"
            )
        if geographic:
            origin = origin or (y, x, 0.0)
            x, y, z = local_metres((y, x, z), origin).tolist()
        marks.setdefault((x, y, z), []).append((photograph.name, x_px, y_px))
    if (several := sum(len(seen) >= 2 for seen in marks.values())) < FEWEST_POINTS:
        raise UserError(
            f"{path}: {several} control points are marked in two of these photographs or more; {FEWEST_POINTS} are needed"
        )
    return ControlPoints(path, marks)


def find_scale(
    model: SolvedModel, source: Source, height_m: float | None, control_points: ControlPoints | None
) -> Scale:
    """The best that there is: the object's height as the user gave it, control points, GPS of the photographs.

    Parameters
    ----------
    model
        In its own frame.
    source
        The photographs, with what EXIF says.
    height_m
        Of the object, if the user knows it.
    control_points
        As `read_control_points` has them.

    Raises
    ------
    UserError
        The control points do not fit the model.
    """
    if control_points is not None:
        fitted = _from_control_points(model, source, control_points)
        return fitted if height_m is None else Scale("length", height_m, None, fitted.up, fitted.notes)
    return Scale("length", height_m) if height_m is not None else _from_gps(model, source)


def _from_control_points(model: SolvedModel, source: Source, points: ControlPoints) -> Scale:
    path = points.path
    row = {name: index for index, name in enumerate(model.names)}
    found, expected, misses_deg = [], [], []
    for place, seen in points.marks.items():
        views, rays = [], []
        for name, x_px, y_px in seen:
            if name in row:
                camera = model.cameras[row[name]]
                shrunk = np.array([camera.width, camera.height]) / source.full_size_px(name)
                views.append(row[name])
                rays.append(np.asarray(camera.cam_from_img(shrunk[None] * [x_px, y_px]))[0])
        if len(rays) >= 2:
            point, miss_deg = _triangulated(model, views, np.array(rays))
            found.append(point)
            expected.append(place)
            misses_deg.append(miss_deg)
    if len(found) < FEWEST_POINTS:
        raise UserError(
            f"{path}: {len(found)} control points are marked in two registered photographs or more; "
            f"{FEWEST_POINTS} are needed"
        )
    if np.median(misses_deg) > WORST_MISS_DEG:
        raise UserError(
            f"{path}: the marks of one control point do not meet (they miss by {np.median(misses_deg):.1f}° in the median); "
            "give marks in pixels of these photographs"
        )
    placed, target = np.array(found), np.array(expected)
    target = target - target.mean(axis=0)
    try:
        fit = align_umeyama(target, placed)
    except ValueError as error:
        raise UserError(f"{path}: the control points coincide") from error
    spread = np.linalg.svd(target, compute_uv=False)
    if spread[1] < 0.02 * spread[0]:
        raise UserError(f"{path}: the control points lie on one line, which does not tell what is up")
    rest = float(np.sqrt(((fit.apply(placed) - target) ** 2).sum(axis=1).mean()))
    if rest > 0.2 * float(np.sqrt((target**2).sum(axis=1).mean())):
        raise UserError(
            f"{path} does not fit the model: {rest:.2f} m rms; are the marks in pixels of these photographs?"
        )
    note = f"scale and up: {len(found)} control points, {rest:.3f} m rms"
    return Scale("control points", None, fit.scale, fit.rotation.T @ np.array([0.0, 0.0, 1.0]), (note,))


def local_metres(position: Place, origin: Place) -> Floats:
    """(3,) east, north and up of (latitude, longitude, altitude) from ``origin``, for distances of kilometres."""
    degrees = np.deg2rad(np.array(position[:2]) - np.array(origin[:2]))
    east = EARTH_M * degrees[1] * np.cos(np.deg2rad(origin[0]))
    return np.array([east, EARTH_M * degrees[0], position[2] - origin[2]])


def _triangulated(model: SolvedModel, views: list[int], rays: Floats) -> tuple[Floats, float]:
    """(3,) the point nearest to rays (K, 2), normalised coordinates in so many photographs, and by how much they miss it."""
    directions = np.einsum(
        "kji,kj->ki", model.poses[views, :3, :3], np.column_stack([rays, np.ones(len(rays))])
    )
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    centers = model.centers[views]
    right = np.einsum("kij,kj->i", across, centers)
    point = np.asarray(np.linalg.lstsq(across.sum(axis=0), right, rcond=None)[0], dtype=float)
    sights = point - centers
    cosines = (sights * directions).sum(axis=1) / np.linalg.norm(sights, axis=1)
    return point, float(np.rad2deg(np.median(np.arccos(np.clip(cosines, -1, 1)))))


def _from_gps(model: SolvedModel, source: Source) -> Scale:
    gps = [source.by_name[name].gps for name in model.names]
    rows = [row for row, position in enumerate(gps) if position is not None]
    if len(rows) < max(4, len(model.names) // 2):
        return Scale("none", notes=("scale: none given; thresholds are shares of the object's height",))
    positions = [position for position in gps if position is not None]
    target = np.array([local_metres(p, positions[0]) for p in positions])
    centers = model.centers[rows]
    try:
        fit = align_umeyama(target, centers)
    except ValueError:
        return Scale("none", notes=("scale: GPS has all photographs in one place",))
    rest = fit.apply(centers) - target
    rms = float(np.sqrt((rest**2).sum(axis=1).mean()))
    spread = fit.scale * float(np.sqrt(((centers - centers.mean(axis=0)) ** 2).sum()))
    error = float(np.sqrt((rest**2).sum() / (3 * len(rows) - 7))) / max(spread, 1e-9)
    told = f"GPS, {rms:.2f} m rms to the cameras, scale to about {200 * error:.0f} %"
    if fit.scale <= 0 or error > WORST_GPS_SCALE / 2:
        return Scale("none", notes=(f"scale: none; {told} is too coarse",))
    return Scale("gps", None, fit.scale, None, (f"scale: {told}",))
