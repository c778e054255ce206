"""Structure from motion on all photographs (COLMAP's incremental mapper), and points for poses that are given."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import cv2  # noqa: F401  before pycolmap: the other order aborts the process when cv2 writes a PNG
import numpy as np
import pycolmap

from nbv.cache import Arrays, Store, digest, remember
from nbv.errors import UserError
from nbv.photographs.correspond import Correspondences, correspondences
from nbv.photographs.folder import Progress, SourcePhotograph
from nbv.photographs.solved import SolvedModel, solved_from_colmap

FILM_DIAGONAL_MM = 43.267
GUESSED_FOCAL = 1.2  # of the long side, where EXIF has none; COLMAP's guess
SMALLEST_MODEL = 6
SECOND_OBJECT = 0.25  # of the photographs in a second model, and they are of two objects
WORKERS = 2
_FILES = ("cameras", "images", "points3D", "rigs", "frames")


def mapped(
    photographs: Sequence[SourcePhotograph],
    sizes_px: dict[str, tuple[int, int]],
    progress: Progress,
    store: Store | None,
    *,
    upright: bool,
) -> tuple[SolvedModel, list[str]]:
    """A model of the photographs, calibrated from EXIF, and notes.

    Parameters
    ----------
    photographs
        Of the folder, in the order in which they were taken.
    sizes_px
        At which they are worked on, by name.
    progress, store
        As in `nbv.photographs.importer.import_photographs`.
    upright
        Whether they are worked on as EXIF turns them.

    Raises
    ------
    UserError
        The photographs do not overlap, or are of two objects.
    """
    cameras, camera_ids = _cameras(photographs, sizes_px)
    per_photograph = [cameras[i] for i in camera_ids]
    found = correspondences(photographs, per_photograph, progress, store, upright=upright)
    if not found.pairs:
        raise UserError(
            f"no two of the {len(photographs)} photographs show the same thing; photographs of one object must overlap"
        )
    names = [p.name for p in photographs]
    entry = remember(
        store,
        "photograph-models",
        lambda: _map(names, cameras, camera_ids, found, progress),
        code=__name__,
        inputs=[names, camera_ids, [f.digest for f in found.features], _pairs_digest(found)],
    )
    counts = entry["counts"].tolist()
    if not counts:
        raise UserError(
            f"the {len(photographs)} photographs overlap too little for a model ({len(found.pairs)} pairs match); "
            "photographs of one object must overlap, neighbours by two thirds"
        )
    if len(counts) > 1 and counts[1] >= max(SMALLEST_MODEL, SECOND_OBJECT * len(photographs)):
        raise UserError(
            f"{counts[0]} photographs make one model and {counts[1]} another: are there two objects? put the "
            "photographs of each into a folder of its own, or add some that show both"
        )
    with tempfile.TemporaryDirectory(prefix="gatetune-model-") as folder:
        for name in _FILES:
            (Path(folder) / f"{name}.bin").write_bytes(entry[name].tobytes())
        reconstruction = pycolmap.Reconstruction(folder)
    model = solved_from_colmap(reconstruction, {name: name for name in names}, sizes_px)
    notes = [
        f"{len(cameras)} camera{'s' if len(cameras) > 1 else ''}, {len(found.pairs)} pairs of photographs match"
    ]
    return model, notes


def triangulated(
    photographs: Sequence[SourcePhotograph],
    model: SolvedModel,
    progress: Progress,
    store: Store | None,
    *,
    upright: bool,
) -> SolvedModel:
    """``model``, which has poses alone, with points.

    Parameters
    ----------
    photographs
        Of the folder.
    model
        Poses and cameras.
    progress, store, upright
        As in `mapped`.

    Raises
    ------
    UserError
        Hardly a point fits the poses: they are of other photographs.
    """
    by_name = {p.name: p for p in photographs}
    chosen = sorted(range(len(model.names)), key=lambda i: photographs.index(by_name[model.names[i]]))
    members = [by_name[model.names[i]] for i in chosen]
    cameras = {row + 1: model.cameras[i] for row, i in enumerate(chosen)}
    for camera_id, camera in cameras.items():
        camera.camera_id = camera_id
        camera.has_prior_focal_length = True
    found = correspondences(members, list(cameras.values()), progress, store, upright=upright)
    names = [p.name for p in members]
    progress("triangulating points", 0, 1)
    cache = found.cache(names, cameras, list(cameras))
    reconstruction = pycolmap.Reconstruction()
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed = 1, 0
    mapper = pycolmap.IncrementalMapper(cache)
    mapper.begin_reconstruction(reconstruction)
    for row, i in enumerate(chosen):
        image = reconstruction.image(row + 1)
        image.frame.set_cam_from_world(image.camera_id, pycolmap.Rigid3d(model.poses[i, :3]))
        reconstruction.register_frame(image.frame_id)
    for row in range(len(chosen)):
        mapper.triangulate_image(options.get_triangulation(), row + 1)
    mapper.complete_and_merge_tracks(options.get_triangulation())
    mapper.filter_points(options.get_mapper())
    mapper.end_reconstruction(discard=False)
    return solved_from_colmap(
        reconstruction,
        {n: n for n in names},
        {n: (c.width, c.height) for n, c in zip(names, cameras.values())},
    )


def _cameras(
    photographs: Sequence[SourcePhotograph], sizes_px: dict[str, tuple[int, int]]
) -> tuple[dict[int, pycolmap.Camera], list[int]]:
    """A camera for each device, size and focal length, by id, and each photograph's id."""
    keys = [(p.device, sizes_px[p.name], p.focal_35_mm) for p in photographs]
    ids = {key: index for index, (key, _) in enumerate(Counter(keys).most_common(), start=1)}
    cameras = {}
    for (_, (width, height), focal_35_mm), camera_id in ids.items():
        known = focal_35_mm is not None
        focal = (
            focal_35_mm / FILM_DIAGONAL_MM * float(np.hypot(width, height))
            if focal_35_mm is not None
            else GUESSED_FOCAL * max(width, height)
        )
        camera = pycolmap.Camera(
            model="SIMPLE_RADIAL",
            width=width,
            height=height,
            params=[focal, width / 2, height / 2, 0.0],
            camera_id=camera_id,
        )
        camera.has_prior_focal_length = known
        cameras[camera_id] = camera
    return cameras, [ids[key] for key in keys]


def _map(
    names: Sequence[str],
    cameras: dict[int, pycolmap.Camera],
    camera_ids: Sequence[int],
    found: Correspondences,
    progress: Progress,
) -> Arrays:
    """The largest model as COLMAP's files, and how many photographs each model has, most first."""
    pycolmap.set_random_seed(0)
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed = WORKERS, 0
    options.extract_colors = False
    options.min_model_size = SMALLEST_MODEL
    # COLMAP iterates to the last bit by default; one part in a million of the cost is far below the noise.
    options.ba_global_function_tolerance = options.ba_local_function_tolerance = 1e-6
    manager = pycolmap.ReconstructionManager()
    pipeline = pycolmap.IncrementalPipeline(options, found.cache(names, cameras, camera_ids), manager)
    registered = 0

    def one_more() -> None:
        nonlocal registered
        registered += 1
        progress("placing photographs", min(registered, len(names)), len(names))

    pipeline.add_callback(pycolmap.IncrementalPipelineCallback.INITIAL_IMAGE_PAIR_REG_CALLBACK, one_more)
    pipeline.add_callback(pycolmap.IncrementalPipelineCallback.NEXT_IMAGE_REG_CALLBACK, one_more)
    pipeline.run()
    models = sorted(
        (manager.get(i) for i in range(manager.size())), key=lambda m: m.num_reg_images(), reverse=True
    )
    counts = np.array([m.num_reg_images() for m in models], dtype=np.int64)
    files = {name: np.zeros(0, np.uint8) for name in _FILES}
    if models:
        with tempfile.TemporaryDirectory(prefix="gatetune-model-") as folder:
            models[0].write_binary(folder)
            files = {n: np.frombuffer((Path(folder) / f"{n}.bin").read_bytes(), np.uint8) for n in _FILES}
    return {"counts": counts, **files}


def _pairs_digest(found: Correspondences) -> str:
    return digest(*(part for ids, pair in sorted(found.pairs.items()) for part in (list(ids), pair.matches)))
