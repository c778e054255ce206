"""How large the model really is: from the object's height, control points or GPS."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2  # noqa: F401  before pycolmap: the other order aborts the process when cv2 writes a PNG
import numpy as np
import pycolmap
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError
from scipy.stats import t as student

from nbv.errors import UserError
from nbv.geometry.frames import Similarity, align_umeyama
from nbv.photographs.folder import files_of_photographs
from nbv.photographs.import_source import ImportSource
from nbv.photographs.photograph_set import ScaleSource
from nbv.photographs.solved import SolvedModel
from nbv.safe_files import expanded, read_text
from nbv.types import Floats

FEWEST_POINTS = 3
WORST_MISS_DEG = 1.0  # of the rays of one control point
WORST_ERROR = 0.1  # of the scale, beyond which it is not told
SURE_ERROR = 0.02  # of the scale, below which control points say what is up
LEVEL = 0.1  # of the control points' extent: heights that differ by less lie level
GEOGRAPHIC, GEOCENTRIC = "EPSG:4979", "EPSG:4978"  # of WGS 84, with heights
_MOST_LINES = 20_000
_UTM = re.compile(r"([\w ]*?)\s*/?\s*UTM\s*(?:zone)?\s*(\d+)\s*([C-X])", re.IGNORECASE)

Position = tuple[float, float, float]  # as the file has it


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
    """Marks (photograph, x, y in its pixels) by place in the coordinate system that the file's first line names."""

    path: Path
    system: str  # as the file has it
    crs: CRS | None  # None: metres of the user's own
    marks: Mapping[Position, Sequence[tuple[str, float, float]]]


def read_control_points(path: Path, source: ImportSource) -> ControlPoints:
    """Marks on these photographs, from a file in OpenDroneMap's ``gcp_list.txt`` format.

    `UserError` where it cannot be read, names no coordinate system, or marks a place outside its photograph.
    """
    path = expanded(path)
    lines = [line.strip() for line in read_text(path, 16 * 2**20).lstrip("\ufeff").splitlines()]
    if not 2 <= len(lines) <= _MOST_LINES:
        raise UserError(f"{path} has {len(lines)} lines; it needs a projection and a line for every mark")
    crs = _system(lines[0], path)
    rows = {n: line.split() for n, line in enumerate(lines[1:], start=2) if line and line[0] != "#"}
    names_of = {  # they may have spaces; the longest first
        n: [" ".join(words[5:end]).lower() for end in range(len(words), 5, -1)] for n, words in rows.items()
    }
    file_of = files_of_photographs(set().union(*names_of.values()), source.photographs, str(path))
    photograph_of = {file: source.by_name[name] for name, file in file_of.items()}
    marks: dict[Position, list[tuple[str, float, float]]] = {}
    for number, words in rows.items():
        try:
            x, y, z, x_px, y_px = (float(word) for word in words[:5])
            file = words[5]
        except (ValueError, IndexError) as error:
            raise UserError(
                f"{path} line {number}: a mark is X Y Z PIXEL_X PIXEL_Y FILE; correct it"
            ) from error
        if not np.isfinite([x, y, z, x_px, y_px]).all():
            raise UserError(f"{path} line {number}: every number must be finite; leave points without Z out")
        photograph = next((photograph_of[n] for n in names_of[number] if n in photograph_of), None)
        if photograph is None:
            continue
        sizes = (photograph.size_px, photograph.upright_size_px)  # a mark may be of either way to hold it
        if not any(0 <= x_px <= width and 0 <= y_px <= height for width, height in sizes):
            width, height = sizes[1]
            raise UserError(
                f"{path} marks ({x_px:g}, {y_px:g}) in {file}, which has {width} x {height} px; "
                "give marks in pixels of these photographs"
            )
        marks.setdefault((x, y, z), []).append((photograph.name, x_px, y_px))
    if (several := sum(len(seen) >= 2 for seen in marks.values())) < FEWEST_POINTS:
        raise UserError(
            f"{path}: {several} control points are marked in two of these photographs or more; {FEWEST_POINTS} are needed"
        )
    try:
        _metres(crs, list(marks))
    except ValueError as error:
        raise UserError(
            f"{path}: there are no such places in {lines[0]}; check its first line, and that X is east (longitude), Y north"
        ) from error
    return ControlPoints(path, lines[0], crs, marks)


def _system(text: str, path: Path) -> CRS | None:
    """The coordinate system of a file's first line; None where it says that places are in metres of the user's own."""
    if re.fullmatch(r"local|m|met(re|er)s?", text, re.IGNORECASE):
        return None
    named = text
    if utm := _UTM.fullmatch(text):
        datum, zone, band = utm.groups()
        datum = "WGS 84" if datum.upper() in ("", "WGS84") else datum
        named = f"{datum} / UTM zone {zone}{'S' if band.upper() == 'S' or band.upper() < 'N' else 'N'}"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of old ways to write it
            crs = CRS.from_user_input(named)
        if len(crs.axis_info) >= 2:
            return crs
    except CRSError:
        pass
    raise UserError(
        f"{path} line 1: {text[:60]!r} is no coordinate system; write EPSG:CODE, WGS84, WGS84 UTM 32N, "
        "a PROJ string, or local for metres of your own"
    )


def find_scale(
    model: SolvedModel, source: ImportSource, height_m: float | None, control_points: ControlPoints | None
) -> Scale:
    """The scale of ``model``, which is in its own frame: from the object's height, control points, or GPS, the first that is there.

    `UserError` where the control points do not fit the model.
    """
    if control_points is not None:
        fitted = _from_control_points(model, source, control_points)
        return fitted if height_m is None else Scale("length", height_m, None, fitted.up, fitted.notes)
    return Scale("length", height_m) if height_m is not None else _from_gps(model, source)


def _from_gps(model: SolvedModel, source: ImportSource) -> Scale:
    gps = {row: at for row, name in enumerate(model.names) if (at := source.by_name[name].gps) is not None}
    if len(gps) < max(4, len(model.names) // 2):
        return Scale(
            "none", notes=("scale: no GPS with altitude; thresholds are shares of the object's height",)
        )
    places = [(longitude, latitude, up_m) for latitude, longitude, up_m in gps.values()]
    try:
        fit, rms_m, off = _fitted(model.centers[list(gps)], _metres(CRS(GEOGRAPHIC), places)[0])
    except ValueError as error:
        return Scale("none", notes=(f"scale: none; the places of the photographs by GPS {error}",))
    quality = f"GPS, {rms_m:.2f} m rms to the cameras, scale to about {_percent(off)}"
    if off > WORST_ERROR:
        return Scale("none", notes=(f"scale: none; {quality} is too coarse",))
    return Scale("gps", None, fit.scale, None, (f"scale: {quality}",))


def _percent(error: float) -> str:
    return f"{np.clip(100 * error, 0.01, 99):.2g} %"


def _from_control_points(model: SolvedModel, source: ImportSource, points: ControlPoints) -> Scale:
    path = points.path
    row = {name: index for index, name in enumerate(model.names)}
    points_in_model, expected, misses_deg = [], [], []
    for position, seen in points.marks.items():
        views, rays = [], []
        for name, x_px, y_px in seen:
            if name in row:
                camera = model.cameras[row[name]]
                shrunk = np.array([camera.width, camera.height]) / source.full_size_px(name)
                views.append(row[name])
                rays.append(camera.cam_ray_from_img(shrunk * [x_px, y_px]))
        if len(rays) >= 2:
            poses = model.poses[views, :3]
            point = pycolmap.triangulate_multi_view_point(poses, rays)
            if point is None:  # behind the cameras
                misses_deg.append(180.0)
                continue
            toward = poses @ [*point, 1.0]
            cosines = (toward * rays).sum(axis=1) / np.linalg.norm(toward, axis=1)
            misses_deg.append(float(np.rad2deg(np.median(np.arccos(cosines.clip(-1, 1))))))
            points_in_model.append(point)
            expected.append(position)
    if len(misses_deg) < FEWEST_POINTS:
        raise UserError(
            f"{path}: {len(misses_deg)} control points are marked in two registered photographs or more; "
            f"{FEWEST_POINTS} are needed"
        )
    if np.median(misses_deg) > WORST_MISS_DEG:
        raise UserError(
            f"{path}: the marks of one control point do not meet (they miss by {np.median(misses_deg):.1f}° in the median); "
            "give marks in pixels of these photographs"
        )
    try:
        places_m, up = _metres(points.crs, expected)
        fit, rms_m, off = _fitted(np.array(points_in_model), places_m)
    except ValueError as error:
        raise UserError(f"{path}: the control points {error}") from error
    reading = "metres of your own"
    if points.crs is not None:
        reading = f"{points.system} ({points.crs.name}), heights in {_height_unit(points.crs)[0]}"
    quality = f"{rms_m:.3f} m rms, scale to about {_percent(off)}; read as {reading}"
    if off > WORST_ERROR:
        raise UserError(
            f"{path} does not fit the model: {quality}; check that reading and that the marks are in pixels of these photographs, "
            "or give --height-m in place of the control points"
        )
    up_in_model, sight = fit.rotation.T @ up, model.centers.mean(axis=0) - np.mean(points_in_model, axis=0)
    heights_m, extent_m = (places_m @ up).std(), np.linalg.norm(places_m.std(axis=0))
    if heights_m < LEVEL * extent_m and up_in_model @ sight < 0:
        raise UserError(
            f"{path} does not fit the model: read as {reading}, the cameras are below the control points; "
            "X is east (longitude), Y north, Z up"
        )
    sure = off < SURE_ERROR
    note = f"scale{' and up' if sure else ''}: {len(points_in_model)} control points, {quality}"
    return Scale("control points", None, fit.scale, up_in_model if sure else None, (note,))


def _height_unit(crs: CRS) -> tuple[str, float]:
    """Name and metres of a coordinate system's unit of height: its own, else of what is horizontal, else the metre."""
    axis = crs.axis_info[-1]
    if len(crs.axis_info) == 2 and not crs.is_projected:
        return "metre", 1.0
    return axis.unit_name, axis.unit_conversion_factor * (-1 if axis.direction == "down" else 1)


def _metres(crs: CRS | None, places: Sequence[Position]) -> tuple[Floats, Floats]:
    """(N, 3) metres in a rectangular frame of the Earth of N places of a file, and (3,) what is up there; `ValueError` where there are none."""
    x, y, z = np.array(places, dtype=float).T
    if crs is None:
        return np.column_stack([x, y, z]), np.array([0.0, 0.0, 1.0])
    try:
        if crs.is_geocentric:
            x, y, z = Transformer.from_crs(crs, GEOGRAPHIC, always_xy=True).transform(x, y, z)
        else:
            x, y = Transformer.from_crs(crs.to_2d(), "EPSG:4326", always_xy=True).transform(x, y)
            z = z * _height_unit(crs)[1]
        to_metres = Transformer.from_crs(GEOGRAPHIC, GEOCENTRIC, always_xy=True)
        places_m, above = (np.column_stack(to_metres.transform(x, y, z + up_m)) for up_m in (0.0, 1.0))
    except ProjError as error:  # of `inf` as well, which stands for no place
        raise ValueError("are no places") from error
    if not np.isfinite(places_m).all():
        raise ValueError("are no places")
    return places_m, above[0] - places_m[0]


def _fitted(points: Floats, places_m: Floats) -> tuple[Similarity, float, float]:
    """The similarity from ``points`` (N, 3) to their places (N, 3), its rms in metres, and the relative error of its scale.

    That is the larger one of its 95 % interval, were residuals independent, and of residuals over extent, which holds the rest:
    heights that are all wrong by one factor shrink a model by less. `ValueError` where the points coincide or lie on one line.
    """
    extent = [np.linalg.svd(part - part.mean(axis=0), compute_uv=False) for part in (points, places_m)]
    if min(singular[0] for singular in extent) < 1e-9:
        raise ValueError("coincide")
    if extent[1][1] < 0.02 * extent[1][0]:
        raise ValueError("lie on one line")
    fit = align_umeyama(places_m, points)
    squares, free = float(((fit.apply(points) - places_m) ** 2).sum()), 3 * len(points) - 7
    interval_m = np.sqrt(squares / free) * student.ppf(0.975, free)
    residual_m = np.sqrt(squares)
    error = max(interval_m, residual_m) / np.linalg.norm(extent[1])
    return fit, float(residual_m / np.sqrt(len(points))), float(error)
