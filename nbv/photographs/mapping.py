"""The sparse model of all photographs: COLMAP's incremental mapper on them, or another program's, with points if it has none.

COLMAP's pipeline drives its mapper here, since all photographs are there and their lenses are to be calibrated.
"""

from __future__ import annotations

import fcntl
import sqlite3
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from nbv.cache import Arrays, cache_key, cached
from nbv.config import SparseConfig
from nbv.errors import UserError
from nbv.photographs.folder import shrunk_size
from nbv.photographs.import_source import ImportSource
from nbv.photographs.model_files import read_model
from nbv.photographs.solved import SolvedModel, solved_from_colmap
from nbv.sparse.colmap import files_of, model_of, pipeline_options
from nbv.sparse.features import extract_features
from nbv.sparse.matching import match_pair

FEWEST_REGISTERED = 6
WORST_MEDIAN_PX = 4.0
# Correlation of the grey of one point in two photographs; of other photographs it is about 0.
LEAST_PHOTO_CONSISTENCY = 0.5
FILM_DIAGONAL_MM = 43.267
GUESSED_FOCAL = 1.2  # of the long side, where EXIF has none; COLMAP's guess
SMALLEST_MODEL = 6
SECOND_OBJECT = 0.25  # of the photographs in a second model, and they are of two objects
WORKERS = 2
_BLUR_PX = 2.0
MAX_FEATURES = 8192  # the largest: where there are more they are small and repeat
# Preemptive matching (Wu 2013, "Towards linear-time incremental structure from motion", section 3): the largest features
# tell which photographs are worth matching with all.
FIRST_FEATURES, FIRST_MATCHES = 800, 4
PARTNERS = 30  # at most, best first
IN_ORDER = 2  # photographs before and after, whatever the largest features say
AT_ONCE = 200  # pairs that are matched between two reports of progress


def solve(source: ImportSource, model_path: Path | None) -> tuple[SolvedModel, ImportSource, list[str]]:
    """A sparse model in a frame of its own, by COLMAP or of another program; its photographs as they are worked on; notes.

    `UserError` where the model is damaged or of other photographs, or the photographs do not overlap or show two objects.
    """
    total = len(source.photographs)
    if model_path is None:
        source = source.turned()
        model, notes = _mapped(source)
    else:
        answers, notes = read_model(model_path, source), [f"sparse model: {model_path.name}"]
        if not len(answers[0][0].xyz):
            answers = [(_triangulated(seen, model), seen) for model, seen in answers]
            notes.append("points triangulated with its poses")
        alike = [_photo_consistency(model, seen) for model, seen in answers]
        # Points of a model fit it either way, but look alike one way only; triangulated ones look alike and fit one way only.
        fit = [
            consistency / (0.1 + _median_px(model))
            for consistency, (model, _) in zip(alike, answers, strict=True)
        ]
        model, source = answers[int(np.argmax(fit))]
        if not max(alike) >= LEAST_PHOTO_CONSISTENCY:
            raise UserError(
                f"{model_path} is a model of other photographs: the images of one of its points do not look alike in them "
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


def _photo_consistency(model: SolvedModel, source: ImportSource) -> float:
    """Intraclass correlation of the grey values that the photographs show of one point, over all points of the model."""
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
    total = len(source.photographs)
    images = _Images(source, [p.name for p in source.photographs], *_cameras(source))
    entry = dict(
        cached(
            source.store,
            "photograph-models",
            lambda: _largest_model(images),
            code=__name__,
            inputs=images.inputs,
        )
    )
    pairs, *counts = entry.pop("counts").tolist()
    if not pairs:
        raise UserError(
            f"no two of the {total} photographs show the same thing; photographs of one object must overlap"
        )
    if not counts:
        raise UserError(
            f"the {total} photographs overlap too little for a model ({pairs} pairs match); "
            "photographs of one object must overlap, neighbours by two thirds"
        )
    if len(counts) > 1 and counts[1] >= max(SMALLEST_MODEL, SECOND_OBJECT * total):
        raise UserError(
            f"{counts[0]} photographs make one model and {counts[1]} another: are there two objects? put the "
            "photographs of each into a folder of its own, or add some that show both"
        )
    model = model_of({name: content.tobytes() for name, content in entry.items()})
    plural = "s" if len(images.cameras) > 1 else ""
    note = f"{len(images.cameras)} camera{plural}, {pairs} pairs of photographs match"
    return solved_from_colmap(model, images.photographs, source), [note]


def _triangulated(source: ImportSource, model: SolvedModel) -> SolvedModel:
    """``model``, which has poses alone, with points."""
    row = {name: index for index, name in enumerate(model.names)}
    names = [p.name for p in source.photographs if p.name in row]
    cameras = {number: model.cameras[row[name]] for number, name in enumerate(names, start=1)}
    posed = pycolmap.Reconstruction()
    for number, camera in cameras.items():
        camera.camera_id = number
        camera.has_prior_focal_length = True
        posed.add_camera_with_trivial_rig(camera)
        image = pycolmap.Image(name=str(number), camera_id=number, image_id=number)
        pose = model.poses[row[names[number - 1]], :3]
        posed.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose))
    images = _Images(source, names, cameras, list(cameras))
    with images.matched() as database, tempfile.TemporaryDirectory() as out:
        source.progress("triangulating points", 0, 1)
        model_with_points = pycolmap.triangulate_points(
            posed, database, out, out, options=pipeline_options(1)
        )
    return solved_from_colmap(model_with_points, images.photographs, source)


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


def _largest_model(images: _Images) -> Arrays:
    """The largest model as COLMAP's files, and how many pairs match and photographs each model has, most first."""
    options, registered, total = pipeline_options(WORKERS), 0, len(images.names)
    options.extract_colors = False
    options.min_model_size = SMALLEST_MODEL

    def one_more() -> None:
        nonlocal registered
        registered += 1
        images.source.progress("placing photographs", min(registered, total), total)

    pycolmap.set_random_seed(0)
    with images.matched() as database, tempfile.TemporaryDirectory() as out:
        with pycolmap.Database.open(database) as opened:
            pairs = np.count_nonzero(opened.read_two_view_geometry_num_inliers()[1])
        models = pycolmap.incremental_mapping(
            database, out, out, options, initial_image_pair_callback=one_more, next_image_callback=one_more
        )
    ranked = sorted(models.values(), key=lambda m: m.num_reg_images(), reverse=True)
    files = {name: np.frombuffer(data, np.uint8) for m in ranked[:1] for name, data in files_of(m).items()}
    return {"counts": np.array([pairs, *(m.num_reg_images() for m in ranked)], dtype=np.int64), **files}


def _is_sound(database: Path) -> bool:
    """Whether an import can go on with a database that another one left: COLMAP ends the process at a damaged one."""
    try:
        with closing(sqlite3.connect(database)) as opened:
            return bool(opened.execute("pragma quick_check").fetchone() == ("ok",))
    except sqlite3.Error:
        return False


@dataclass(frozen=True)
class _Images:
    """Photographs in the order in which they were taken, and their cameras; in COLMAP their ids and names count from 1."""

    source: ImportSource
    names: list[str]
    cameras: dict[int, pycolmap.Camera]
    camera_ids: list[int]

    @property
    def photographs(self) -> dict[str, str]:
        """The photographs' names by COLMAP's."""
        return {str(number): name for number, name in enumerate(self.names, start=1)}

    @property
    def inputs(self) -> list[object]:
        """What decides features and matches."""
        calibrations = [
            f"{c.model_name} {c.params_to_string()} {c.has_prior_focal_length}" for c in self.cameras.values()
        ]
        files = [(name, self.source.by_name[name].sha256, *self.source.size_px(name)) for name in self.names]
        return [list(map(list, files)), self.source.upright, calibrations, self.camera_ids]

    @contextmanager
    def matched(self) -> Iterator[Path]:
        """COLMAP's database with features and verified matches: in the store, where there is one, so that an import can go on.

        An import of the same photographs waits for the one that has it.
        """
        store, progress = self.source.store, self.source.progress
        with ExitStack() as stack:
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="nbv-matches-"))
            path, listed = Path(folder) / "database.db", Path(folder) / "pairs.txt"
            if store is not None:
                key = cache_key(__name__, *self.inputs)
                stored = store.root / "photograph-matches" / key[:2] / key
                with suppress(OSError):  # nobody may write there
                    stored.parent.mkdir(parents=True, exist_ok=True)
                    lock = stack.enter_context(stored.with_name(f".{key}.lock").open("ab"))
                    try:
                        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    except BlockingIOError:
                        progress("waiting for another import of these photographs", 0, 1)
                        fcntl.flock(lock, fcntl.LOCK_EX)
                    if stored.exists() and not _is_sound(stored):
                        stored.unlink()
                    stored.touch()
                    path = stored
            with pycolmap.Database.open(path) as database:
                self._write_features(database)
                pairs = self._pairs(database)
            matching = pycolmap.FeatureMatchingOptions(num_threads=WORKERS, use_gpu=False)
            verifying = pycolmap.TwoViewGeometryOptions()
            verifying.detect_watermark = False  # borders that are alike are no reason to give a pair up
            verifying.ransac.random_seed = 0
            for start in range(0, len(pairs), AT_ONCE):
                progress("matching photographs", start, len(pairs))
                listed.write_text("".join(f"{a} {b}\n" for a, b in pairs[start : start + AT_ONCE]))
                pairing = pycolmap.ImportedPairingOptions(match_list_path=str(listed))
                pycolmap.match_image_pairs(path, matching, pairing, verifying, pycolmap.Device.cpu)
            yield path

    def _write_features(self, database: pycolmap.Database) -> None:
        for camera_id, camera in self.cameras.items():
            if not database.exists_rig(camera_id):
                rig = pycolmap.Rig(rig_id=camera_id)
                rig.add_ref_sensor(camera.sensor_id)
                with pycolmap.DatabaseTransaction(database):
                    database.write_camera(camera, use_camera_id=True)
                    database.write_rig(rig, use_rig_id=True)
        kind = pycolmap.FeatureExtractorType.SIFT
        for number, (name, camera_id) in enumerate(zip(self.names, self.camera_ids, strict=True), start=1):
            self.source.progress("finding features", number - 1, len(self.names))
            if database.exists_image(number):
                continue
            features = extract_features(self.source.pixels(name), SparseConfig(max_features=MAX_FEATURES))
            # COLMAP's limit keeps the scale that reaches it whole.
            largest = np.argsort(-features.keypoints[:, 2], kind="stable")[:MAX_FEATURES]
            image = pycolmap.Image(name=str(number), camera_id=camera_id, image_id=number)
            frame = pycolmap.Frame(frame_id=number, rig_id=camera_id)
            frame.add_data_id(image.data_id)
            descriptors = pycolmap.FeatureDescriptors(kind, features.descriptors[largest])
            with pycolmap.DatabaseTransaction(database):
                database.write_image(image, use_image_id=True)
                database.write_frame(frame, use_frame_id=True)
                database.write_keypoints(number, features.keypoints[largest])
                database.write_descriptors(number, descriptors)

    def _pairs(self, database: pycolmap.Database) -> list[tuple[int, int]]:
        """Ids of the images that are worth matching with one another."""
        count = len(self.names)
        ids = range(1, count + 1)
        largest = {i: np.array(database.read_descriptors(i).data)[:FIRST_FEATURES] for i in ids}
        alike = np.zeros((count + 1, count + 1), dtype=np.int64)
        for a in ids:
            self.source.progress("comparing photographs", a - 1, count)
            for b in range(a + 1, count + 1):
                alike[a, b] = alike[b, a] = len(match_pair(largest[a], largest[b]))
        chosen = {(a, b) for a in ids for b in range(a + 1, min(a + IN_ORDER, count) + 1)}
        for a in ids:
            best = np.argsort(-alike[a], kind="stable")[:PARTNERS]
            chosen |= {(min(a, b), max(a, b)) for b in best.tolist() if alike[a, b] >= FIRST_MATCHES}
        return sorted(chosen)
