"""``gatetune photographs import``: from a folder of photographs to a set on disk, whole or not at all.

Every stage that takes long keeps its result in the store, so that an import that was killed goes on where it was. The
set is written beside its place and moved there when it is whole.
"""

from __future__ import annotations

import functools
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray
from PIL import Image

from nbv.cache import Store
from nbv.config import CameraConfig
from nbv.errors import UserError
from nbv.geometry.frames import Similarity
from nbv.photographs.dense_reference import View, cloud_of_views, distances_to, halves_agreement
from nbv.photographs.folder import Progress, SourcePhotograph, read_folder, read_pixels, up_in_picture
from nbv.photographs.kept_out import drawn_out
from nbv.photographs.masks import Mask, find_masks
from nbv.photographs.model_files import working_sizes
from nbv.photographs.object_cloud import in_box, object_cloud, weak_places
from nbv.photographs.object_frame import find_object, placement
from nbv.photographs.photograph_set import (
    IMAGES,
    MASKS,
    REFERENCE_FILE,
    SPARSE,
    SURFACE_FILE,
    Photograph,
    PhotographSet,
    read_set,
    set_folder,
    sets_folder,
)
from nbv.photographs.pinhole import common_pinhole, undistorted
from nbv.photographs.reference_file import Reference, write_reference
from nbv.photographs.scale import find_scale, read_control_points
from nbv.photographs.solve import solve
from nbv.photographs.solved import SolvedModel, write_colmap
from nbv.photographs.surface import surface_of
from nbv.rocks.imported import check_name, imported_path, write_rock
from nbv.rocks.recipes import RECIPES
from nbv.types import Bools, Floats, PointCloud

MAX_SIZE_PX = 1280
JPEG_QUALITY = 95


@dataclass(frozen=True)
class ImportOptions:
    """What the user says beside the folder."""

    model: Path | None = None  # of another program
    masks: Path | None = None
    height_m: float | None = None  # of the object
    control_points: Path | None = None
    max_size_px: int = MAX_SIZE_PX

    def __post_init__(self) -> None:
        if not 320 <= self.max_size_px <= 8000:
            raise UserError(f"max_size is {self.max_size_px}; it must be 320 to 8000 px")
        if self.height_m is not None and not 0.001 <= self.height_m <= 10_000:
            raise UserError(f"height_m is {self.height_m:g}; give the object's height in metres")


def import_photographs(
    folder: str | Path,
    name: str,
    options: ImportOptions,
    progress: Progress,
    store: Store | None = None,
    *,
    force: bool = False,
) -> PhotographSet:
    """Make a set of a folder of photographs; what it found is in the set's notes.

    Parameters
    ----------
    folder
        Photographs of one object, densely taken.
    name
        Of the set; from then on it stands where a rock's name may stand.
    options
        A model, masks and scale.
    progress
        Told what is done.
    store
        Keeps features, pairs, the sparse model and clouds, so that an import can go on.
    force
        Replace a set of the same name.

    Raises
    ------
    UserError
        As `read_folder`, `solve`, `find_object` and their like: nothing has been written then.
    """
    _check_free(name, force=force)
    photographs, notes = read_folder(folder, progress)
    masks = {} if options.masks is None else find_masks(options.masks, photographs)
    marked = None
    if options.control_points is not None:
        marked = read_control_points(options.control_points, photographs)
    model, upright, more = solve(photographs, options.max_size_px, options.model, progress, store)
    sizes = working_sizes(photographs, options.max_size_px, upright=upright)
    full = {p.name: p.upright_size_px if upright else p.size_px for p in photographs}
    scale = find_scale(model, photographs, full, options.height_m, marked)
    by_name = {p.name: p for p in photographs}
    ups = np.array([up_in_picture(by_name[name], upright=upright) for name in model.names])
    frame = find_object(model, ups, _in_masks(model, sizes, masks), scale.up)
    model = model.moved(frame.set_from_model)

    pinhole = common_pinhole(model.cameras)
    sets_folder().mkdir(parents=True, exist_ok=True)
    for left in sets_folder().glob(f".{name}.*"):  # by an import that was killed; no name has a full stop
        shutil.rmtree(left, ignore_errors=True)
    work = Path(tempfile.mkdtemp(dir=sets_folder(), prefix=f".{name}."))
    try:
        _write_pictures(photographs, model, pinhole, sizes, masks, work, progress, upright=upright)
        views = _views(photographs, model, masks, work)
        near = model.xyz[in_box(model.xyz, frame)]
        out = drawn_out({view.name: view.sha256 for view in views})
        views = [view for view in views if view.name not in out]
        clouds = [
            cloud_of_views(part, pinhole, frame.center_m, frame.half_width_m, near, store, progress, what)
            for part, what in (
                (views, "dense reference of all photographs but those kept out"),
                (views[::2], "dense cloud of one half of them"),
                (views[1::2], "dense cloud of the other half"),
            )
        ]
        progress("comparing the halves", 0, 1)
        whole, *halves = (object_cloud(cloud, frame, masked=bool(masks)) for cloud in clouds)
        low, high = np.percentile(whole.points_m, [0.2, 99.8], axis=0)
        if not masks:
            low[2] = frame.low_m[2]
        placed = placement(low, high, model.centers)
        model = model.moved(placed)
        whole, first, second = (_moved(cloud, placed) for cloud in (whole, *halves))
        width, depth, height = (float(side) for side in placed.scale * (high - low))
        error_m = np.maximum(distances_to(first, whole.points_m), distances_to(second, whole.points_m))
        assert whole.colors is not None and whole.normals is not None
        reference = Reference(whole.points_m, whole.normals, whole.colors, error_m)
        poses = dict(zip(model.names, model.poses, strict=True))
        made = PhotographSet(
            name=name,
            folder=work,
            camera=pinhole,
            photographs=tuple(_record(p, poses, masks) for p in photographs),
            height_m=height,
            extents_m=(width, depth, height),
            metres_per_unit=scale.metres_per_unit(frame.set_from_model.scale * placed.scale, height),
            scale_source=scale.source,
            reference_error_m=float(np.median(error_m)),
            halves=halves_agreement(first, second, whole, height),
            weak=weak_places(reference, height),
            notes=(
                *notes,
                *more,
                *frame.notes,
                *scale.notes,
                f"{len(out)} kept out of the reference, to judge by",
            ),
            source_folder=str(folder),
        )
        write_colmap(model, pinhole, work / SPARSE)
        write_reference(reference, work / REFERENCE_FILE)
        progress("meshing the reference", 0, 1)
        write_rock(surface_of(reference, name, height), work / SURFACE_FILE)
        made.write(work)
        _move_in(work, set_folder(name))
    except BaseException:
        shutil.rmtree(work, ignore_errors=True)
        raise
    return read_set(set_folder(name))


def _check_free(name: str, *, force: bool) -> None:
    check_name(name)
    if name in RECIPES or imported_path(name).exists():
        raise UserError(f"{name!r} is the name of a rock; choose another --name")
    if set_folder(name).exists() and not force:
        raise UserError(f"there is already a set {name!r}; choose another --name or pass --force")


def _in_masks(
    model: SolvedModel, sizes: Mapping[str, tuple[int, int]], masks: Mapping[str, Mask]
) -> Bools | None:
    """(T,) whether each observation lies on the object; where a photograph has no mask it does not."""
    if not masks:
        return None
    inside = np.zeros(len(model.views), dtype=bool)
    for view, name in enumerate(model.names):
        if name in masks:
            mask = masks[name].read(sizes[name])
            of_view = model.views == view
            columns, rows = model.xy_px[of_view].astype(int).T
            inside[of_view] = mask[np.clip(rows, 0, len(mask) - 1), np.clip(columns, 0, mask.shape[1] - 1)]
    return inside


def _write_pictures(
    photographs: Sequence[SourcePhotograph],
    model: SolvedModel,
    pinhole: CameraConfig,
    sizes: Mapping[str, tuple[int, int]],
    masks: Mapping[str, Mask],
    work: Path,
    progress: Progress,
    *,
    upright: bool,
) -> None:
    """Every photograph and mask as the pinhole would have taken it; those without a pose with the lens of the others."""
    (work / IMAGES).mkdir()
    if masks:
        (work / MASKS).mkdir()
    cameras = dict(zip(model.names, model.cameras, strict=True))
    of_size = {sizes[name]: camera for name, camera in cameras.items()}
    for index, photograph in enumerate(photographs):
        progress("undistorting photographs", index, len(photographs))
        name = photograph.name
        camera = cameras.get(name) or of_size.get(sizes[name]) or _rescaled(model.cameras[0], sizes[name])
        pixels = read_pixels(photograph.path, max(sizes[name]), upright=upright)
        picture = Image.fromarray(undistorted(pixels, camera, pinhole))
        picture.save(work / IMAGES / f"{name}.jpg", quality=JPEG_QUALITY)
        if name in masks:
            mask = masks[name].read(sizes[name]).astype(np.uint8) * np.uint8(255)
            Image.fromarray(undistorted(mask, camera, pinhole, smooth=False)).save(
                work / MASKS / f"{name}.png"
            )


def _rescaled(camera: pycolmap.Camera, size_px: tuple[int, int]) -> pycolmap.Camera:
    other = pycolmap.Camera(camera.todict())
    other.rescale(*size_px)
    return other


def _views(
    photographs: Sequence[SourcePhotograph], model: SolvedModel, masks: Mapping[str, Mask], work: Path
) -> list[View]:
    """The registered photographs in the order in which they were taken."""
    poses = dict(zip(model.names, model.poses, strict=True))

    def pixels(name: str) -> NDArray[np.uint8]:
        with Image.open(work / IMAGES / f"{name}.jpg") as picture:
            return np.asarray(picture.convert("RGB"))

    def mask(name: str) -> Bools | None:
        if name not in masks:
            return None
        with Image.open(work / MASKS / f"{name}.png") as picture:
            return np.asarray(picture) > 127

    return [
        View(
            p.name,
            poses[p.name],
            functools.partial(pixels, p.name),
            functools.partial(mask, p.name),
            p.sha256,
            masks[p.name].sha256 if p.name in masks else "",
        )
        for p in photographs
        if p.name in poses
    ]


def _moved(cloud: PointCloud, placed: Similarity) -> PointCloud:
    """Shifted and scaled; `nbv.photographs.object_frame.placement` does not turn."""
    return PointCloud(placed.apply(cloud.points_m), cloud.colors, cloud.normals)


def _record(
    photograph: SourcePhotograph, poses: Mapping[str, Floats], masks: Mapping[str, Mask]
) -> Photograph:
    return Photograph(
        name=photograph.name,
        source=photograph.path.name,
        sha256=photograph.sha256,
        camera_from_world=poses.get(photograph.name),
        masked=photograph.name in masks,
        time=photograph.time,
        gps=photograph.gps,
        gimbal_deg=photograph.gimbal_deg,
    )


def _move_in(work: Path, folder: Path) -> None:
    """Put a whole set in its place; the one that was there goes only then."""
    old = None
    if folder.exists():
        old = work.with_name(f"{work.name}.old")
        folder.rename(old)
    work.chmod(0o755)
    work.rename(folder)
    if old is not None:
        shutil.rmtree(old, ignore_errors=True)
