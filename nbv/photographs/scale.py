"""How large the model really is: from the object's height, control points or GPS."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2  # noqa: F401  before pycolmap: the other order aborts the process when cv2 writes a PNG
import numpy as np
import pycolmap
from pyproj import CRS, Proj, Transformer
from pyproj.exceptions import CRSError, ProjError
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import t as student

from nbv.errors import UserError
from nbv.geometry.frames import align_umeyama
from nbv.photographs.folder import files_of_photographs
from nbv.photographs.import_source import ImportSource
from nbv.photographs.photograph_set import ScaleSource
from nbv.photographs.solved import SolvedModel
from nbv.safe_files import expanded, read_text
from nbv.types import Floats

FEWEST_POINTS = 3
WORST_MISS_DEG = 1.0  # of the rays of one control point
WORST_ERROR = 0.1  # of the scale, beyond which it is not told
SURE_ERROR = 0.01  # of the scale, below which places are taken as their file says
BETTER = 3.0  # times less rest speaks for another reading of the places than the one that their file says
WGS84 = "EPSG:4326"
_MOST_LINES = 20_000
_UTM = re.compile(r"([\w ]*?)\s*/?\s*UTM\s*(?:zone)?\s*(\d+)\s*([C-X])", re.IGNORECASE)

PositionM = tuple[float, float, float | None]  # as the file has it; None: no height


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
    marks: Mapping[PositionM, Sequence[tuple[str, float, float]]]


@dataclass(frozen=True)
class _Fit:
    """A model laid over places in metres."""

    reading: str  # of the places
    scale: float  # metres per unit of the model
    up: Floats | None  # (3,) in the model's frame; None without heights
    size_m: float  # of the places, rms about their mean
    rms_m: float
    sigma_m: float  # standard deviation of a coordinate
    error: float  # relative, of the scale


def read_control_points(path: Path, source: ImportSource) -> ControlPoints:
    """Marks on these photographs, from a file in OpenDroneMap's ``gcp_list.txt`` format.

    `UserError` where it cannot be read, names no coordinate system, or marks a place outside its photograph.
    """
    path = expanded(path)
    lines = [line.strip() for line in read_text(path, 16 * 2**20).lstrip("\ufeff").splitlines()]
    if not 2 <= len(lines) <= _MOST_LINES:
        raise UserError(f"{path} has {len(lines)} lines; it needs a projection and a line for every mark")
    crs = _system(lines[0], path)
    texts = (line.split()[5:] for line in lines[1:] if not line.startswith("#"))  # names may have spaces
    names = {" ".join(words[:end]).lower() for words in texts for end in range(len(words), 0, -1)}
    found = files_of_photographs(names, source.photographs, str(path))
    of_file = {file: source.by_name[name] for name, file in found.items()}
    marks: dict[PositionM, list[tuple[str, float, float]]] = {}
    for number, line in enumerate(lines[1:], start=2):
        if not line or line.startswith("#"):
            continue
        words = line.split()
        try:
            x, y, z, x_px, y_px = (float(word) for word in words[:5])
            file = words[5]
        except (ValueError, IndexError) as error:
            raise UserError(
                f"{path} line {number}: a mark is X Y Z PIXEL_X PIXEL_Y FILE; correct it"
            ) from error
        if not np.isfinite([x, y, x_px, y_px]).all() or np.isinf(z):
            raise UserError(
                f"{path} line {number}: every number must be finite; only Z may be NaN, if it is not known"
            )
        named = (" ".join(words[5:end]).lower() for end in range(len(words), 5, -1))  # the longest
        if (photograph := next((of_file[name] for name in named if name in of_file), None)) is None:
            continue
        sizes = (photograph.size_px, photograph.upright_size_px)  # a mark may be of either way to hold it
        if not any(0 <= x_px <= width and 0 <= y_px <= height for width, height in sizes):
            width, height = sizes[1]
            raise UserError(
                f"{path} marks ({x_px:g}, {y_px:g}) in {file}, which has {width} x {height} px; "
                "give marks in pixels of these photographs"
            )
        marks.setdefault((x, y, None if np.isnan(z) else z), []).append((photograph.name, x_px, y_px))
    if (several := sum(len(seen) >= 2 for seen in marks.values())) < FEWEST_POINTS:
        raise UserError(
            f"{path}: {several} control points are marked in two of these photographs or more; {FEWEST_POINTS} are needed"
        )
    if not _interpretations(crs, lines[0], list(marks)):
        raise UserError(f"{path}: there are no such places in {lines[0]}; check its first line")
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


def _from_control_points(model: SolvedModel, source: ImportSource, points: ControlPoints) -> Scale:
    path = points.path
    row = {name: index for index, name in enumerate(model.names)}
    found, expected, misses_deg = [], [], []
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
            found.append(point)
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
        fit = _best_fit(np.array(found), _interpretations(points.crs, points.system, expected), model.centers)
    except ValueError as error:
        raise UserError(f"{path}: the control points {error}") from error
    if fit.error > WORST_ERROR:
        raise UserError(
            f"{path} does not fit the model: {fit.rms_m:.2f} m rms, read as {fit.reading}, scale to about "
            f"{_percent(fit.error)}; check that reading and that the marks are in pixels of these photographs, or give --height-m "
            "in place of the control points"
        )
    told = f"{len(found)} control points, {fit.rms_m:.3f} m rms, scale to about {_percent(fit.error)}; read as {fit.reading}"
    return Scale(
        "control points", None, fit.scale, fit.up, (f"scale{'' if fit.up is None else ' and up'}: {told}",)
    )


def _from_gps(model: SolvedModel, source: ImportSource) -> Scale:
    gps = {row: at for row, name in enumerate(model.names) if (at := source.by_name[name].gps) is not None}
    if len(gps) < max(4, len(model.names) // 2):
        return Scale("none", notes=("scale: none given; thresholds are shares of the object's height",))
    latitude, longitude, up_m = np.array(list(gps.values()), dtype=float).T
    flat_m = _local_m(CRS(WGS84), longitude, latitude)
    heights = {"GPS": up_m} if np.isfinite(up_m).any() else {}
    heights["GPS without altitude"] = np.full(len(gps), np.nan)
    found = model.centers[list(gps)]
    try:
        fit = _best_fit(found, {n: np.column_stack([flat_m, up]) for n, up in heights.items()}, found)
    except ValueError as error:
        return Scale("none", notes=(f"scale: none; the places of the photographs by GPS {error}",))
    told = f"{fit.reading}, {fit.rms_m:.2f} m rms to the cameras, scale to about {_percent(fit.error)}"
    if fit.error > WORST_ERROR:
        return Scale("none", notes=(f"scale: none; {told} is too coarse",))
    return Scale("gps", None, fit.scale, None, (f"scale: {told}",))


def _percent(error: float) -> str:
    return f"{np.clip(100 * error, 0.01, 99):.2g} %"


def _interpretations(crs: CRS | None, system: str, places: Sequence[PositionM]) -> dict[str, Floats]:
    """What N places of a file may mean, what it says first: (N, 3) metres east, north, up; NaN where there is no height.

    People give latitude before longitude, and heights in another unit than what is horizontal.
    """
    x, y, z = np.array(places, dtype=float).T
    if crs is None:
        return {"metres of your own": np.column_stack([x, y, z])}
    name = system if crs.name in ("unknown", system) else f"{system} ({crs.name})"
    if crs.is_geocentric:
        x, y, z = Transformer.from_crs(crs, "EPSG:4979", always_xy=True).transform(x, y, z)
        return {name: np.column_stack([_local_m(CRS(WGS84), x, y), z])}
    third = len(crs.axis_info) == 3
    axis = crs.axis_info[-1]
    unit, unit_m = "metre", 1.0
    if third or crs.is_projected:
        unit, unit_m = axis.unit_name, axis.unit_conversion_factor
    units_m = {unit: -unit_m if axis.direction == "down" else unit_m}
    units_m |= {name: metres for name, metres in {"metre": 1.0, "foot": 0.3048}.items() if name != unit}
    heights = {f"heights in {u}": z * metres for u, metres in units_m.items() if np.isfinite(z).any()}
    heights["without heights"] = np.full(len(z), np.nan)
    flat, first = crs.to_2d(), "latitude" if crs.is_geographic else "north"
    orders = {"": (x, y), f", {first} first": (y, x)}
    orders = {order: at for order, at in orders.items() if _within_area_of_use(flat, *at)} or orders
    local_m = {order: _local_m(flat, *at) for order, at in orders.items()}
    return {
        f"{name}{order}, {reading}": np.column_stack([flat_m, up_m])
        for reading, up_m in heights.items()
        for order, flat_m in local_m.items()
        if np.isfinite(flat_m).all()
    }


def _within_area_of_use(crs: CRS, x: Floats, y: Floats) -> bool:
    """Whether ``crs`` is made for where these places begin: its area of use, or where a PROJ string is true to scale."""
    try:
        longitude, latitude = Transformer.from_crs(crs, WGS84, always_xy=True).transform(
            x[0], y[0], errcheck=True
        )
        if (area := crs.area_of_use) is None:
            scale = 1.0 if crs.is_geographic else Proj(crs).get_factors(longitude, latitude).meridional_scale
            return abs(scale - 1) < 0.05
    except ProjError:
        return False
    wide_deg = (area.east - area.west) % 360 or 360
    along = (longitude - area.west + 5) % 360 <= wide_deg + 10
    return bool(along and area.south - 5 <= latitude <= area.north + 5)


def _local_m(crs: CRS, x: Floats, y: Floats) -> Floats:
    """(N, 2) metres east and north of the first of N places in ``crs``; not finite where there are none."""
    try:
        longitude, latitude = Transformer.from_crs(crs, WGS84, always_xy=True).transform(x[0], y[0])
        local = CRS(f"+proj=aeqd +lat_0={latitude} +lon_0={longitude} +datum=WGS84")
        return np.column_stack(Transformer.from_crs(crs, local, always_xy=True).transform(x, y))
    except ProjError:  # of `inf` as well, which stands for no place
        return np.full((len(x), 2), np.inf)


def _best_fit(found: Floats, readings: Mapping[str, Floats], centers: Floats) -> _Fit:
    """The first reading of the places (N, 3) of ``found`` (N, 3), unless another one fits far better.

    A plane fits its mirror image as well, but then the cameras (V, 3) are below it. Without heights all points do: where another
    order of coordinates fits as well, the error of the scale holds it. `ValueError` says why nothing can be fitted.
    """
    fits, trouble = [], ValueError("coincide")
    for reading, places_m in readings.items():
        try:
            fits.append(_fitted(reading, found, places_m))
        except ValueError as error:
            trouble = error
    if not fits:
        raise trouble
    sight = centers.mean(axis=0) - found.mean(axis=0)
    best, least_m = fits[0], np.inf
    for fit in fits:
        below = fit.up is not None and fit.up @ sight < 0
        rest_m = max(fit.sigma_m, 1e-4 * fit.size_m) * (10 if below else 1)
        if BETTER * rest_m < least_m:
            best, least_m = fit, rest_m
        if best.error < SURE_ERROR and best.up is not None and not below:
            return best
    if best.up is not None:
        return best
    alike = [
        fit for fit in fits if fit.up is None and fit.sigma_m < BETTER * best.sigma_m + 1e-4 * best.size_m
    ]
    return replace(best, error=best.error + max(abs(fit.scale / best.scale - 1) for fit in alike))


def _fitted(reading: str, found: Floats, places_m: Floats) -> _Fit:
    """The similarity that brings ``found`` (N, 3) to its places (N, 3), by least squares over what is known of them.

    The error of the scale is the larger one of its 95 % interval, were residuals independent, and of residuals over extent, which
    holds the rest: heights that are all wrong by one amount shrink a model by less. `ValueError` where the points coincide, lie
    on one line, or are too few.
    """
    known = np.isfinite(places_m)
    middle_m = np.nanmean(np.where(known.any(axis=0), places_m, 0.0), axis=0)
    x, y = found - found.mean(axis=0), places_m - middle_m
    unit, size_m = (float(np.sqrt(np.nansum(part**2) / len(x))) for part in (x, y))
    if not (unit > 1e-9 and size_m > 1e-6):
        raise ValueError("coincide")
    x, y = x / unit, y / size_m
    extent = np.linalg.svd(np.where(known, y, 0.0), compute_uv=False)
    if extent[1] < 0.02 * extent[0]:
        raise ValueError("lie on one line")
    whole = known.all(axis=1)
    if whole.sum() >= FEWEST_POINTS:
        begin = align_umeyama(y[whole], x[whole]).rotation
    else:
        u, _, vt = np.linalg.svd(np.linalg.lstsq(x, y[:, :2], rcond=0.05)[0].T, full_matrices=False)
        begin = np.vstack([u @ vt, np.cross(*(u @ vt))])

    def turned(p: Floats) -> Floats:
        return np.asarray(Rotation.from_rotvec(p[1:4]).as_matrix() @ begin)

    solved = least_squares(lambda p: (np.exp(p[0]) * x @ turned(p).T + p[4:] - y)[known], np.zeros(7))
    jacobian = solved.jac
    free = known.sum() - np.linalg.matrix_rank(jacobian, tol=1e-3 * np.linalg.norm(jacobian, 2))
    if free < 2:
        raise ValueError("are too few without heights")
    sigma = float(np.sqrt(2 * solved.cost / free))
    own = sigma * float(np.sqrt(np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-6, hermitian=True)[0, 0]))
    rms = float(np.sqrt(2 * solved.cost / len(x)))
    return _Fit(
        reading,
        float(np.exp(solved.x[0])) * size_m / unit,
        turned(solved.x)[2] if known[:, 2].any() else None,
        size_m,
        rms * size_m,
        sigma * size_m,
        max(rms, own * float(student.ppf(0.975, free))),
    )
