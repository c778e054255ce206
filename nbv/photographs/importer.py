"""``gatetune photographs import``: from a folder of photographs to a set on disk, whole or not at all.

Every stage that takes long keeps its result in the store, so that an import that was killed goes on where it was. The
set is written beside its place and moved there when it is whole.
"""

from __future__ import annotations

import shutil
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2  # before pycolmap: the other order aborts the process when cv2 writes a PNG
import numpy as np
import pycolmap
from numpy.typing import NDArray
from PIL import Image

from nbv.cache import Store
from nbv.config import CameraConfig
from nbv.errors import UserError
from nbv.evaluation.evaluate import moved
from nbv.geometry.frames import align_umeyama
from nbv.photographs.dense_reference import (
    ReferenceMaker,
    halves_agreement,
    surface_of,
    weak_sectors,
)
from nbv.photographs.folder import Progress, read_folder
from nbv.photographs.import_source import ImportSource, find_masks
from nbv.photographs.object_frame import find_object, placement
from nbv.photographs.photograph_set import (
    IMAGES,
    MASKS,
    REFERENCE_FILE,
    SPARSE,
    SURFACE_FILE,
    Photograph,
    PhotographSet,
    Reference,
    ScaleSource,
    read_set,
    set_folder,
    sets_folder,
)
from nbv.photographs.sparse_model import SolvedModel, solve
from nbv.rocks.catalogue import check_name, imported_path, write_rock
from nbv.safe_files import expanded
from nbv.sparse.colmap import CAMERA_ID, colmap_camera
from nbv.types import Floats

MAX_SIZE_PX, MIN_SIZE_PX = 1280, 320  # of the long side
JPEG_QUALITY = 95
WIDEST = 0.3  # shortest focal length of the pinhole, as a share of the lens's own: of a fisheye that sees half the world
WORST_GPS_ERROR = 0.1  # of the cameras' extent, beyond which GPS gives no scale


@dataclass(frozen=True)
class ImportOptions:
    """What the user says beside the folder."""

    model: Path | None = None  # COLMAP's
    masks: Path | None = None
    height_m: float | None = None  # of the object
    metres_per_unit: float | None = None  # of ``model``
    max_size_px: int = MAX_SIZE_PX

    def __post_init__(self) -> None:
        if not MIN_SIZE_PX <= self.max_size_px <= 8000:
            raise UserError(f"max_size is {self.max_size_px}; it must be {MIN_SIZE_PX} to 8000 px")
        if self.height_m is not None and not 0.001 <= self.height_m <= 10_000:
            raise UserError(f"height_m is {self.height_m:g}; give the object's height in metres")
        if self.metres_per_unit is not None:
            if not 1e-6 <= self.metres_per_unit <= 1e6:
                raise UserError(
                    f"metres_per_unit is {self.metres_per_unit:g}; give the metres of one unit of the model"
                )
            if self.model is None or self.height_m is not None:
                raise UserError(
                    "--metres-per-unit is of the model that --model names, and stands in place of --height-m"
                )


def import_photographs(
    folder: str | Path,
    name: str,
    options: ImportOptions,
    progress: Progress,
    store: Store | None = None,
    *,
    force: bool = False,
) -> PhotographSet:
    """Make the set ``name`` of a folder of photographs of one object; ``force`` replaces a set of the same name.

    `UserError`, before anything is written, as `read_folder`, `solve` and `find_object` raise it.
    """
    check_name(name, "a set of photographs")
    if imported_path(name).exists():
        raise UserError(f"{name!r} is the name of a rock; choose another --name")
    if set_folder(name).exists() and not force:
        raise UserError(f"there is already a set {name!r}; choose another --name or pass --force")
    folder = expanded(folder)
    photographs, notes = read_folder(folder, progress, options.masks)
    if (size_px := max((p.size_px for p in photographs), key=max)) and max(size_px) < MIN_SIZE_PX:
        raise UserError(
            f"the photographs in {folder} have {size_px[0]} x {size_px[1]} px at most, too few to be reconstructed; "
            f"give larger ones, of {MIN_SIZE_PX} px or more on the long side"
        )
    masks = {} if options.masks is None else find_masks(options.masks, photographs)
    source = ImportSource(tuple(photographs), options.max_size_px, progress, store, masks=masks)
    model, source, solved_notes = solve(source, options.model)
    scale_source, metres, scale_notes = find_scale(model, source, options)
    frame = find_object(model, source)
    model = model.moved(frame.frame_from_model)
    pinhole = common_pinhole(model.cameras)
    sets_folder().mkdir(parents=True, exist_ok=True)
    for left in sets_folder().glob(f".{name}.*"):  # by an import that was killed; no name has a full stop
        shutil.rmtree(left, ignore_errors=True)
    work = Path(tempfile.mkdtemp(dir=sets_folder(), prefix=f".{name}."))
    old = work.with_name(f"{work.name}.old")
    try:
        _write_pictures(source, model, pinhole, work)
        views = [p for p in _records(source, model, folder) if p.registered]
        maker = ReferenceMaker(source, work, pinhole, frame, model.xyz[frame.in_box(model.xyz)])
        whole, *halves = (
            maker.cloud(part, what)
            for part, what in (
                (views, "dense reference of all photographs"),
                (views[::2], "dense cloud of one half of them"),
                (views[1::2], "dense cloud of the other half"),
            )
        )
        progress("comparing the halves", 0, 1)
        low, high = np.percentile(whole.points_m, [0.2, 99.8], axis=0)
        if frame.grounded:
            low[2] = frame.low_m[2]
        placed = placement(low, high, model.centers)
        model = model.moved(placed)
        whole, *halves = (moved(cloud, placed) for cloud in (whole, *halves))
        width, depth, height = (float(side) for side in placed.scale * (high - low))
        agreement, error_m = halves_agreement(whole, halves, height)
        metres_per_unit = None if metres is None else metres / (frame.frame_from_model.scale * placed.scale)
        assert whole.colors is not None and whole.normals is not None
        reference = Reference(whole.points_m, whole.normals, whole.colors, error_m)
        made = PhotographSet(
            name=name,
            folder=work,
            camera=pinhole,
            photographs=_records(source, model, folder),
            height_m=height,
            extents_m=(width, depth, height),
            metres_per_unit=metres_per_unit if options.height_m is None else options.height_m / height,
            scale_source=scale_source,
            reference_error_m=float(np.median(error_m)),
            halves=agreement,
            weak=weak_sectors(reference, height),
            notes=(*notes, *solved_notes, *frame.notes, *scale_notes),
            source_folder=str(folder),
        )
        write_colmap(model, pinhole, work / SPARSE)
        reference.write(work / REFERENCE_FILE)
        progress("meshing the reference", 0, 1)
        write_rock(surface_of(reference, name, height), work / SURFACE_FILE)
        made.write(work)
        work.chmod(0o755)
        if set_folder(name).exists():  # the one that was there goes only when this one is whole
            set_folder(name).rename(old)
        work.rename(set_folder(name))
    except BaseException:
        shutil.rmtree(work, ignore_errors=True)
        raise
    shutil.rmtree(old, ignore_errors=True)
    return read_set(set_folder(name))


def _write_pictures(source: ImportSource, model: SolvedModel, pinhole: CameraConfig, work: Path) -> None:
    """Every photograph with a pose, and its mask, as the pinhole would have taken it."""
    (work / IMAGES).mkdir()
    if source.masks:
        (work / MASKS).mkdir()
    for index, (name, camera) in enumerate(zip(model.names, model.cameras, strict=True)):
        source.progress("undistorting photographs", index, len(model.names))
        picture = Image.fromarray(undistorted(source.pixels(name), camera, pinhole))
        picture.save(work / IMAGES / f"{name}.jpg", quality=JPEG_QUALITY)
        if (mask := source.mask(name)) is not None:
            white = undistorted(mask.astype(np.uint8) * np.uint8(255), camera, pinhole)
            Image.fromarray(white).save(work / MASKS / f"{name}.png")


def _records(source: ImportSource, model: SolvedModel, folder: Path) -> tuple[Photograph, ...]:
    """The photographs as the set has them, with their poses in ``model``."""
    poses: dict[str, Floats] = dict(zip(model.names, model.poses, strict=True))
    return tuple(
        Photograph(
            name=photograph.name,
            source=str(photograph.path.relative_to(folder)).encode(errors="replace").decode(),
            sha256=photograph.sha256,
            camera_from_world=poses.get(photograph.name),
            masked=photograph.name in source.masks,
        )
        for photograph in source.photographs
    )


def find_scale(
    model: SolvedModel, source: ImportSource, options: ImportOptions
) -> tuple[ScaleSource, float | None, list[str]]:
    """What says how large the object is, metres per unit of ``model`` where that says it, and a note."""
    if options.height_m is not None:
        return "length", None, []
    if options.metres_per_unit is not None:
        return "model", options.metres_per_unit, []
    gps = {row: at for row, name in enumerate(model.names) if (at := source.by_name[name].gps) is not None}
    if len(gps) < max(4, len(model.names) // 2):
        return "none", None, ["scale: no GPS with altitude; thresholds are shares of the object's height"]
    transform = pycolmap.GPSTransform(pycolmap.GPSTransformEllipsoid.WGS84)
    places_m = np.asarray(transform.ellipsoid_to_ecef(list(gps.values())))
    centers = model.centers[list(gps)]
    fit = align_umeyama(places_m, centers)
    off_m = float(np.linalg.norm(fit.apply(centers) - places_m))
    extent_m = float(np.linalg.norm(places_m - places_m.mean(axis=0)))
    quality = f"GPS, {off_m / np.sqrt(len(gps)):.2f} m rms to the cameras"
    if not off_m <= WORST_GPS_ERROR * extent_m:
        return "none", None, [f"scale: none; {quality}, is too coarse; give --height-m"]
    return "gps", fit.scale, [f"scale: {quality}, to about {max(100 * off_m / extent_m, 0.01):.2g} %"]


def common_pinhole(cameras: Sequence[pycolmap.Camera]) -> CameraConfig:
    """The pinhole of the largest size, with the shortest focal length that the photographs fill of its most frequent camera."""
    largest = max(camera.width * camera.height for camera in cameras)
    cameras = [camera for camera in cameras if camera.width * camera.height == largest]
    keys = [camera.params_to_string() + f"{camera.model}{camera.width}x{camera.height}" for camera in cameras]
    camera = cameras[keys.index(Counter(keys).most_common(1)[0][0])]
    width, height = camera.width, camera.height
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    border = np.ones((height, width), dtype=bool)
    border[1:-1, 1:-1] = False
    at = np.column_stack([x[border], y[border]])
    rays = np.array(camera.cam_from_img(at))
    seen = camera.img_from_cam(np.column_stack([rays, np.ones(len(rays))]))
    ahead = np.abs(seen - at).max(axis=1) < 1  # else behind a pinhole: a fisheye sees farther
    # No pixel on the photograph's border lies within the pinhole's picture.
    inside = np.array([width - 1, height - 1]) / 2 / np.maximum(np.abs(rays[ahead]), 1e-9)
    focal_px = inside.min(axis=1).max(initial=WIDEST * camera.mean_focal_length())
    return CameraConfig(width, height, round(float(focal_px), 3))


def undistorted(
    pixels: NDArray[np.uint8], camera: pycolmap.Camera, pinhole: CameraConfig
) -> NDArray[np.uint8]:
    """(H, W, 3) or (H, W) the picture (H', W', ...) of a camera of its size, as the pinhole would have taken it.

    Black where the photograph does not reach. A mask, (H', W'), is not interpolated.
    """
    x, y = np.meshgrid(np.arange(pinhole.width_px) + 0.5, np.arange(pinhole.height_px) + 0.5)
    rays = np.stack([x - pinhole.width_px / 2, y - pinhole.height_px / 2], axis=-1) / pinhole.focal_px
    seen = camera.img_from_cam(np.dstack([rays, np.ones(x.shape)]).reshape(-1, 3)).reshape(*x.shape, 2)
    columns, rows = (seen - 0.5).astype(np.float32).transpose(2, 0, 1)
    mode = cv2.INTER_LINEAR if pixels.ndim == 3 else cv2.INTER_NEAREST
    return np.asarray(cv2.remap(pixels, columns, rows, mode, borderMode=cv2.BORDER_CONSTANT), np.uint8)


def write_colmap(model: SolvedModel, camera: CameraConfig, folder: Path) -> None:
    """Write the model as COLMAP's binary files with one pinhole camera; images are called ``NAME.jpg``."""
    out = pycolmap.Reconstruction()
    middle = (camera.width_px / 2, camera.height_px / 2)
    out.add_camera_with_trivial_rig(colmap_camera(camera))
    feature = np.zeros(len(model.views), dtype=np.int64)
    for view, name in enumerate(model.names):
        members = np.flatnonzero(model.views == view)
        feature[members] = np.arange(len(members))
        rays = model.cameras[view].cam_from_img(model.xy_px[members]) if len(members) else np.zeros((0, 2))
        image: Any = pycolmap.Image(
            name=f"{name}.jpg",
            keypoints=camera.focal_px * np.asarray(rays) + middle,
            camera_id=CAMERA_ID,
            image_id=view + 1,
        )
        out.add_image_with_trivial_frame(image, pycolmap.Rigid3d(model.poses[view, :3]))
    bounds = np.searchsorted(model.points, np.arange(len(model.xyz) + 1))
    for point, xyz in enumerate(model.xyz):
        elements = [
            pycolmap.TrackElement(int(model.views[i]) + 1, int(feature[i]))
            for i in range(bounds[point], bounds[point + 1])
        ]
        out.add_point3D(xyz, pycolmap.Track(elements), model.rgb[point])
    out.update_point_3d_errors()
    folder.mkdir(parents=True, exist_ok=True)
    out.write_binary(folder)
