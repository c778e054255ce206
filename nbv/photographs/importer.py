"""``gatetune photographs import``: from a folder of photographs to a set on disk, whole or not at all.

Every stage that takes long keeps its result in the store, so that an import that was killed goes on where it was. The
set is written beside its place and moved there when it is whole.
"""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from nbv.cache import Store
from nbv.config import CameraConfig
from nbv.errors import UserError
from nbv.evaluation.registration import moved
from nbv.photographs.dense_reference import (
    ReferenceMaker,
    halves_agreement,
    surface_of,
    weak_sectors,
)
from nbv.photographs.folder import Progress, find_masks, read_folder
from nbv.photographs.import_source import ImportSource
from nbv.photographs.mapping import solve
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
    read_set,
    set_folder,
    sets_folder,
)
from nbv.photographs.pinhole import common_pinhole, undistorted
from nbv.photographs.scale import find_scale, read_control_points
from nbv.photographs.solved import SolvedModel, write_colmap
from nbv.rocks.catalogue import check_name, imported_path, write_rock
from nbv.safe_files import expanded
from nbv.types import Floats

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
    masks = {} if options.masks is None else find_masks(options.masks, photographs)
    source = ImportSource(tuple(photographs), options.max_size_px, progress, store, masks=masks)
    marked = None if options.control_points is None else read_control_points(options.control_points, source)
    model, source, solved_notes = solve(source, options.model)
    scale = find_scale(model, source, options.height_m, marked)
    frame = find_object(model, source, scale.up)
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
        assert whole.colors is not None and whole.normals is not None
        reference = Reference(whole.points_m, whole.normals, whole.colors, error_m)
        made = PhotographSet(
            name=name,
            folder=work,
            camera=pinhole,
            photographs=_records(source, model, folder),
            height_m=height,
            extents_m=(width, depth, height),
            metres_per_unit=scale.metres_per_unit(frame.frame_from_model.scale * placed.scale, height),
            scale_source=scale.source,
            reference_error_m=float(np.median(error_m)),
            halves=agreement,
            weak=weak_sectors(reference, height),
            notes=(*notes, *solved_notes, *frame.notes, *scale.notes),
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
