"""The sparse model of all photographs: COLMAP's incremental mapper on them, or another program's, with points if it has none."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from nbv.cache import Arrays, cached, digest
from nbv.errors import UserError
from nbv.photographs.correspond import Correspondences, correspondences
from nbv.photographs.folder import Progress, shrunk_size
from nbv.photographs.import_source import ImportSource
from nbv.photographs.model_files import read_model
from nbv.photographs.solved import SolvedModel, solved_from_colmap
from nbv.sparse.colmap import files_of, model_of

FEWEST_REGISTERED = 6
WORST_MEDIAN_PX = 4.0
# Correlation of the grey of one point in two photographs; of other photographs it is about 0.
LEAST_LIKENESS = 0.5
FILM_DIAGONAL_MM = 43.267
GUESSED_FOCAL = 1.2  # of the long side, where EXIF has none; COLMAP's guess
SMALLEST_MODEL = 6
SECOND_OBJECT = 0.25  # of the photographs in a second model, and they are of two objects
WORKERS = 2
_BLUR_PX = 2.0


def solve(source: ImportSource, model_path: Path | None) -> tuple[SolvedModel, ImportSource, list[str]]:
    """A sparse model in a frame of its own, ours or another program's; its photographs as they are worked on; notes.

    Raises
    ------
    UserError
        The model is damaged or of other photographs; or the photographs do not overlap, or are of two objects.
    """
    total = len(source.photographs)
    if model_path is None:
        source = source.turned()
        model, notes = _mapped(source)
    else:
        answers, notes = read_model(model_path, source)
        notes = [f"sparse model: {model_path.name}", *notes]
        if not len(answers[0][0].xyz):
            answers = [(_triangulated(seen, model), seen) for model, seen in answers]
            notes.append("points triangulated with its poses")
        alike = [_likeness(model, seen) for model, seen in answers]
        # Points of a model fit it either way, but look alike one way only; triangulated ones look alike and fit one way only.
        fit = [
            likeness / (0.1 + _median_px(model)) for likeness, (model, _) in zip(alike, answers, strict=True)
        ]
        model, source = answers[int(np.argmax(fit))]
        if not max(alike) >= LEAST_LIKENESS:
            raise UserError(
                f"{model_path} is a model of other photographs: what it takes for one point is not alike in them "
                f"(correlation {max(alike):.2f})"
            )
    registered = len(model.names)
    if registered < FEWEST_REGISTERED:
        raise UserError(
            f"only {registered} of {total} photographs have a pose; a set needs {FEWEST_REGISTERED}"
        )
    median_px = _median_px(model)
    if not median_px <= WORST_MEDIAN_PX:
        raise UserError(
            f"the model does not fit the photographs: {median_px:.1f} px median reprojection error"
        )
    notes.append(
        f"{registered} of {total} photographs registered, {len(model.xyz)} points, "
        f"{median_px:.2f} px median reprojection error"
    )
    return model, source, notes


def _median_px(model: SolvedModel) -> float:
    return float(np.median(model.reprojection_errors_px())) if len(model.views) else np.inf


def _likeness(model: SolvedModel, source: ImportSource) -> float:
    """Correlation of the greys that the photographs show where the model says that they show the same point."""
    if not len(model.views):
        return 0.0
    grey = np.zeros(len(model.views))
    for view, name in enumerate(model.names):
        source.progress("comparing the model with the photographs", view, len(model.names))
        picture = cv2.cvtColor(source.pixels(name), cv2.COLOR_RGB2GRAY)
        members, pixels = model.of_view(view)
        grey[members] = cv2.GaussianBlur(picture, (0, 0), _BLUR_PX)[pixels]
    count = np.bincount(model.points)
    mean = np.bincount(model.points, weights=grey) / np.maximum(count, 1)
    # Share of the variance that is between points and not within them: the intraclass correlation.
    within = float(((grey - mean[model.points]) ** 2).sum() / max(len(grey) - len(count), 1))
    return 1 - within / max(float(grey.var()), 1e-9)


def _mapped(source: ImportSource) -> tuple[SolvedModel, list[str]]:
    """A model of the photographs, calibrated from EXIF, and notes."""
    total = len(source.photographs)
    cameras, camera_ids = _cameras(source)
    names = [p.name for p in source.photographs]
    found = correspondences(source, names, [cameras[i] for i in camera_ids])
    if not found.pairs:
        raise UserError(
            f"no two of the {total} photographs show the same thing; photographs of one object must overlap"
        )
    matches = digest(*(part for ids, p in sorted(found.pairs.items()) for part in (list(ids), p.matches)))
    entry = dict(
        cached(
            source.store,
            "photograph-models",
            lambda: _largest_model(cameras, camera_ids, found, source.progress),
            code=__name__,
            inputs=[names, camera_ids, [f.digest for f in found.features], matches],
        )
    )
    counts = entry.pop("counts").tolist()
    if not counts:
        raise UserError(
            f"the {total} photographs overlap too little for a model ({len(found.pairs)} pairs match); "
            "photographs of one object must overlap, neighbours by two thirds"
        )
    if len(counts) > 1 and counts[1] >= max(SMALLEST_MODEL, SECOND_OBJECT * total):
        raise UserError(
            f"{counts[0]} photographs make one model and {counts[1]} another: are there two objects? put the "
            "photographs of each into a folder of its own, or add some that show both"
        )
    model = model_of({name: content.tobytes() for name, content in entry.items()})
    plural = "s" if len(cameras) > 1 else ""
    note = f"{len(cameras)} camera{plural}, {len(found.pairs)} pairs of photographs match"
    return solved_from_colmap(model, {name: name for name in names}, source), [note]


def _triangulated(source: ImportSource, model: SolvedModel) -> SolvedModel:
    """``model``, which has poses alone, with points."""
    row = {name: index for index, name in enumerate(model.names)}
    names = [p.name for p in source.photographs if p.name in row]
    cameras = {number: model.cameras[row[name]] for number, name in enumerate(names, start=1)}
    for camera_id, camera in cameras.items():
        camera.camera_id = camera_id
        camera.has_prior_focal_length = True
    found = correspondences(source, names, list(cameras.values()))
    source.progress("triangulating points", 0, 1)
    reconstruction = pycolmap.Reconstruction()
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed = 1, 0
    cache = found.cache(cameras, list(cameras))
    mapper = pycolmap.IncrementalMapper(cache)
    mapper.begin_reconstruction(reconstruction)
    for image_id, name in enumerate(names, start=1):
        image = reconstruction.image(image_id)
        image.frame.set_cam_from_world(image.camera_id, pycolmap.Rigid3d(model.poses[row[name], :3]))
        reconstruction.register_frame(image.frame_id)
    for image_id in cameras:
        mapper.triangulate_image(options.get_triangulation(), image_id)
    mapper.complete_and_merge_tracks(options.get_triangulation())
    mapper.filter_points(options.get_mapper())
    mapper.end_reconstruction(discard=False)
    return solved_from_colmap(reconstruction, {name: name for name in names}, source)


def _cameras(source: ImportSource) -> tuple[dict[int, pycolmap.Camera], list[int]]:
    """A camera for each device, size and focal length, by id, and each photograph's id."""
    keys = [(p.device, source.full_size_px(p.name), p.focal_35_mm) for p in source.photographs]
    ids = {key: index for index, (key, _) in enumerate(Counter(keys).most_common(), start=1)}
    cameras = {}
    for (_, full_size_px, focal_35_mm), camera_id in ids.items():
        width, height = shrunk_size(full_size_px, source.max_size_px)
        focal = GUESSED_FOCAL * max(width, height)
        if focal_35_mm is not None:
            focal = focal_35_mm / FILM_DIAGONAL_MM * float(np.hypot(width, height))
        camera = pycolmap.Camera(
            model="SIMPLE_RADIAL",
            width=width,
            height=height,
            params=[focal, width / 2, height / 2, 0.0],
            camera_id=camera_id,
        )
        camera.has_prior_focal_length = focal_35_mm is not None
        cameras[camera_id] = camera
    return cameras, [ids[key] for key in keys]


def _largest_model(
    cameras: dict[int, pycolmap.Camera], camera_ids: list[int], found: Correspondences, progress: Progress
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
    pipeline = pycolmap.IncrementalPipeline(options, found.cache(cameras, camera_ids), manager)
    registered = 0

    def one_more() -> None:
        nonlocal registered
        registered += 1
        progress("placing photographs", min(registered, len(found.names)), len(found.names))

    pipeline.add_callback(pycolmap.IncrementalPipelineCallback.INITIAL_IMAGE_PAIR_REG_CALLBACK, one_more)
    pipeline.add_callback(pycolmap.IncrementalPipelineCallback.NEXT_IMAGE_REG_CALLBACK, one_more)
    pipeline.run()
    models = sorted(map(manager.get, range(manager.size())), key=lambda m: m.num_reg_images(), reverse=True)
    files = {name: np.frombuffer(data, np.uint8) for m in models[:1] for name, data in files_of(m).items()}
    return {"counts": np.array([m.num_reg_images() for m in models], dtype=np.int64), **files}
