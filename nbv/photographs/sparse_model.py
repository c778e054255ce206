"""The sparse model of all photographs: by COLMAP's own pipeline, or a COLMAP model of the user's."""

from __future__ import annotations

import fcntl
import struct
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2  # before pycolmap: the other order aborts the process when cv2 writes a PNG
import numpy as np
import pycolmap
from numpy.typing import NDArray
from PIL import Image

from nbv.cache import Arrays, cache_key, cached
from nbv.errors import UserError
from nbv.geometry.frames import Similarity, camera_centers_m
from nbv.photographs.folder import SAME_RATIO, shrunk_size
from nbv.photographs.import_source import ImportSource, files_of_photographs
from nbv.safe_files import expanded, read_bytes
from nbv.sparse.colmap import camera_from_world_poses, files_of, model_of, pipeline_options
from nbv.sparse.features import match_pair
from nbv.types import Floats, Ints

FEWEST_REGISTERED = 6
WORST_MEDIAN_PX = 4.0
# Correlation of the grey of one point in two photographs; of other photographs it is about 0.
LEAST_PHOTO_CONSISTENCY = 0.5
FILM_DIAGONAL_MM = 43.267
GUESSED_FOCAL = 1.2  # of the long side, where EXIF has none; COLMAP's guess
SMALLEST_MODEL = 6
SECOND_OBJECT = 0.25  # of the photographs in a second model, and they are of two objects
WORKERS = 2
# Preemptive matching (Wu 2013, "Towards linear-time incremental structure from motion", section 3): the largest features
# tell which photographs are worth matching with all. All pairs of 300 photographs take 86 minutes of a processor.
FIRST_FEATURES, FIRST_MATCHES = 800, 4
PARTNERS = 30  # at most, best first
IN_ORDER = 2  # photographs before and after, whatever the largest features say
_AT_ONCE = 16  # photographs, or a tenth as many pairs, between two reports of progress
_BLUR_PX = 2.0
_MAX_MODEL_BYTES = 2 * 2**30
_MAX_SIDE_PX = 100_000
# Focal lengths that lenses have, in long sides of the picture, and distortion beyond any lens.
_FOCAL_SIDES, _MAX_DISTORTION = (0.05, 200.0), 100.0


@dataclass(frozen=True)
class SolvedModel:
    """Poses, cameras and points with tracks. Observation ``i`` is of point ``points[i]`` by photograph ``views[i]``."""

    names: tuple[str, ...]  # (M,) of the registered photographs
    poses: Floats  # (M, 4, 4) camera_from_model
    cameras: tuple[pycolmap.Camera, ...]  # (M,) at the size that the photographs are worked on
    xyz: Floats  # (N, 3)
    rgb: NDArray[np.uint8]  # (N, 3)
    points: Ints  # (T,)
    views: Ints  # (T,)
    xy_px: Floats  # (T, 2) pixel centres at half-integers
    median_px: float  # reprojection error of the points, in pixels of the model

    @property
    def centers(self) -> Floats:
        """(M, 3) camera centres."""
        return camera_centers_m(self.poses)

    @property
    def axes(self) -> Floats:
        """(M, 3) optical axes."""
        return self.poses[:, 2, :3]

    def moved(self, target_from_model: Similarity) -> SolvedModel:
        poses = camera_from_world_poses(self.poses, target_from_model)
        return replace(self, poses=poses, xyz=target_from_model.apply(self.xyz))

    def of_view(self, view: int) -> tuple[Ints, tuple[Ints, Ints]]:
        """Which observations (K,) a photograph has, and their pixels' rows (K,) and columns (K,)."""
        members = np.flatnonzero(self.views == view)
        width, height = self.cameras[view].width, self.cameras[view].height
        columns, rows = self.xy_px[members].astype(int).T
        return members, (np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1))


def solve(source: ImportSource, model_path: Path | None) -> tuple[SolvedModel, ImportSource, list[str]]:
    """A sparse model in a frame of its own, by COLMAP or the user's; its photographs as they are worked on; notes.

    `UserError` where the model is damaged or of other photographs, or the photographs do not overlap or show two objects.
    """
    total = len(source.photographs)
    if model_path is None:
        source = source.turned()
        model, notes = _mapped(source)
    else:
        answers, notes = read_model(model_path, source), [f"sparse model: {model_path.name}"]
        alike = [_photo_consistency(model, seen) for model, seen in answers]
        model, source = answers[int(np.argmax(alike))]
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
    if not model.median_px <= WORST_MEDIAN_PX:
        raise UserError(
            f"the model does not fit the photographs: {model.median_px:.1f} px median reprojection error"
        )
    notes.append(
        f"{registered} of {total} photographs registered, {len(model.xyz)} points, "
        f"{model.median_px:.2f} px median reprojection error"
    )
    return model, source, notes


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


# -- COLMAP's pipeline -----------------------------------------------------------------------------------------


def _mapped(source: ImportSource) -> tuple[SolvedModel, list[str]]:
    total = len(source.photographs)
    cameras, camera_ids = cameras_of(source)
    inputs = [
        [[p.name, p.sha256, *source.size_px(p.name)] for p in source.photographs],
        source.upright,
        [f"{c.params_to_string()} {c.has_prior_focal_length}" for c in cameras.values()],
        camera_ids,
    ]
    key = cache_key(__name__, *inputs)
    entry = dict(
        cached(
            source.store,
            "photograph-models",
            lambda: _largest_model(source, cameras, camera_ids, key),
            code=__name__,
            inputs=inputs,
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
    name_of = {_file(index): p.name for index, p in enumerate(source.photographs)}
    plural = "s" if len(cameras) > 1 else ""
    note = f"{len(cameras)} camera{plural}, {pairs} pairs of photographs match"
    return solved_from_colmap(model, name_of, source), [note]


def cameras_of(source: ImportSource) -> tuple[dict[int, pycolmap.Camera], list[int]]:
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


def _file(index: int) -> str:
    """What a photograph is called in COLMAP's database, by its place in the order in which they were taken."""
    return f"{index:05d}.png"


def _largest_model(
    source: ImportSource, cameras: Mapping[int, pycolmap.Camera], camera_ids: Sequence[int], key: str
) -> Arrays:
    """The largest model as COLMAP's files, and how many pairs match and photographs each model has, most first."""
    options, registered, total = pipeline_options(WORKERS), 0, len(source.photographs)
    options.min_model_size = SMALLEST_MODEL

    def one_more() -> None:
        nonlocal registered
        registered += 1
        source.progress("placing photographs", min(registered, total), total)

    with _database(source, key) as database, tempfile.TemporaryDirectory(prefix="nbv-photographs-") as folder:
        match_photographs(source, cameras, camera_ids, database, Path(folder))
        with pycolmap.Database.open(database) as opened:
            pairs = np.count_nonzero(opened.read_two_view_geometry_num_inliers()[1])
        pycolmap.set_random_seed(0)
        models = pycolmap.incremental_mapping(
            database,
            folder,
            folder,
            options,
            initial_image_pair_callback=one_more,
            next_image_callback=one_more,
        )
    ranked = sorted(models.values(), key=lambda m: m.num_reg_images(), reverse=True)
    files = {name: np.frombuffer(data, np.uint8) for m in ranked[:1] for name, data in files_of(m).items()}
    return {"counts": np.array([pairs, *(m.num_reg_images() for m in ranked)], dtype=np.int64), **files}


@contextmanager
def _database(source: ImportSource, key: str) -> Iterator[Path]:
    """Where COLMAP's database is: in the store, where there is one, so that an import can go on; one import at a time has it."""
    with ExitStack() as stack:
        if source.store is None:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="nbv-matches-")))
        else:
            folder = source.store.root / "photograph-matches" / key[:2]
            folder.mkdir(parents=True, exist_ok=True)
            lock = stack.enter_context((folder / f".{key}.lock").open("a"))
            source.progress("opening the database of features and matches", 0, 1)
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield folder / key


def match_photographs(
    source: ImportSource,
    cameras: Mapping[int, pycolmap.Camera],
    camera_ids: Sequence[int],
    database: Path,
    folder: Path,
) -> None:
    """Write the photographs into ``folder``, and their features and verified matches into ``database`` where they are not yet."""
    names = [p.name for p in source.photographs]
    for index, name in enumerate(names):
        source.progress("preparing photographs", index, len(names))
        Image.fromarray(source.pixels(name)).save(folder / _file(index), compress_level=1)
    with pycolmap.Database.open(database) as opened:
        for camera_id, camera in cameras.items():
            if not opened.exists_camera(camera_id):
                opened.write_camera(camera, use_camera_id=True)
    files = [_file(index) for index in range(len(names))]
    for camera_id in cameras:
        members = [file for file, of in zip(files, camera_ids, strict=True) if of == camera_id]
        reader = pycolmap.ImageReaderOptions(existing_camera_id=camera_id)
        pycolmap.import_images(database, folder, pycolmap.CameraMode.SINGLE, members, reader)
    extraction = pycolmap.FeatureExtractionOptions(num_threads=WORKERS, use_gpu=False)
    for start in range(0, len(files), _AT_ONCE):
        source.progress("finding features", start, len(files))
        pycolmap.extract_features(
            database,
            folder,
            files[start : start + _AT_ONCE],
            extraction_options=extraction,
            device=pycolmap.Device.cpu,
        )
    pairs, listed = _pairs(source, database), folder / "pairs.txt"
    matching = pycolmap.FeatureMatchingOptions(num_threads=WORKERS, use_gpu=False)
    verifying = pycolmap.TwoViewGeometryOptions()
    verifying.detect_watermark = False  # borders that are alike are no reason to give a pair up
    verifying.ransac.random_seed = 0
    for start in range(0, len(pairs), 10 * _AT_ONCE):
        source.progress("matching photographs", start, len(pairs))
        listed.write_text(
            "".join(f"{_file(a)} {_file(b)}\n" for a, b in pairs[start : start + 10 * _AT_ONCE])
        )
        pairing = pycolmap.ImportedPairingOptions(match_list_path=str(listed))
        pycolmap.match_image_pairs(database, matching, pairing, verifying, pycolmap.Device.cpu)


def _pairs(source: ImportSource, database: Path) -> list[tuple[int, int]]:
    """Which photographs are worth matching with one another."""
    count = len(source.photographs)
    with pycolmap.Database.open(database) as opened:
        ids = [opened.read_image_with_name(_file(index)).image_id for index in range(count)]
        largest = [np.array(opened.read_descriptors(i).data)[:FIRST_FEATURES] for i in ids]
    alike = np.zeros((count, count), dtype=np.int64)
    for a in range(count):
        source.progress("comparing photographs", a, count)
        for b in range(a + 1, count):
            alike[a, b] = alike[b, a] = len(match_pair(largest[a], largest[b]))
    chosen = {(a, b) for a in range(count) for b in range(a + 1, min(a + IN_ORDER + 1, count))}
    for a in range(count):
        best = np.argsort(-alike[a], kind="stable")[:PARTNERS]
        chosen |= {(min(a, b), max(a, b)) for b in best.tolist() if alike[a, b] >= FIRST_MATCHES}
    return sorted(chosen)


# -- a model of the user's -------------------------------------------------------------------------------------


def read_model(path: Path, source: ImportSource) -> list[tuple[SolvedModel, ImportSource]]:
    """A COLMAP model and the photographs as it may see them: turned as EXIF says, or not, or either.

    `UserError` where it cannot be read, is of other photographs or has no points.
    """
    path = expanded(path)
    if path.suffix.lower() in (".bin", ".txt"):
        path = path.parent
    if not path.exists():
        raise UserError(f"there is no model {path}; check --model")
    if not path.is_dir():
        raise UserError(
            f"{path} is no COLMAP model; export one and give its folder (Metashape: File > Export > Export Cameras as "
            "Colmap; OpenSfM: bin/opensfm export_colmap DATASET; nerfstudio keeps one in colmap/sparse/0), or leave --model out"
        )
    model = _colmap(path)
    images = {model.image(i).name: model.image(i) for i in sorted(model.reg_image_ids())}
    file_of = files_of_photographs(images, source.photographs, str(path))
    if not file_of:
        raise UserError(
            f"{path} is a model of other photographs: none of its {len(images)} images "
            f"({', '.join(list(images)[:2])}{', ...' if len(images) > 2 else ''}) is in the folder"
        )
    if not model.num_points3D():
        raise UserError(
            f"{path} has poses and no points; make points with colmap point_triangulator, or leave --model out"
        )
    name_of = {file: name for name, file in file_of.items()}
    cameras = {name: model.camera(images[file].camera_id) for file, name in name_of.items()}
    for name, camera in cameras.items():
        if (
            not all(1 <= side <= _MAX_SIDE_PX for side in (camera.width, camera.height))
            or camera.is_spherical()
            or not camera.verify_params()
            or not np.isfinite(camera.params).all()
            or camera.has_bogus_params(*_FOCAL_SIDES, _MAX_DISTORTION)
        ):
            raise UserError(
                f"{path} cannot be read: no perspective picture is of a {camera.model_name} of {camera.width} x {camera.height} px "
                f"with {camera.params_to_string()} (of {file_of[name]}); export it again"
            )
    answers = []
    for upright in (True, False) if any(source.by_name[n].orientation != 1 for n in cameras) else (True,):
        seen = replace(source, upright=upright)
        sizes = {name: seen.full_size_px(name) for name in cameras}
        if all(
            abs(c.width / c.height * sizes[name][1] / sizes[name][0] - 1) < SAME_RATIO
            for name, c in cameras.items()
        ):
            solved = solved_from_colmap(model, name_of, seen)
            if not (np.isfinite(solved.poses).all() and np.isfinite(solved.xyz).all()):
                raise UserError(f"{path} has poses or points that are not finite; export it again")
            answers.append((solved, seen))
    if not answers:
        name, camera = next(iter(cameras.items()))
        photograph = source.by_name[name]
        raise UserError(
            f"{path} is a model of other photographs: it has {photograph.path.name} with {camera.width} x {camera.height} px, "
            f"the folder with {photograph.size_px[0]} x {photograph.size_px[1]}"
        )
    return answers


def _colmap(folder: Path) -> pycolmap.Reconstruction:
    ends = [e for e in (".bin", ".txt") if all((folder / f"{n}{e}").is_file() for n in ("images", "cameras"))]
    if not ends:
        raise UserError(
            f"there is no COLMAP model in {folder}; it has cameras, images and points3D, .bin or .txt"
        )
    model = pycolmap.Reconstruction()
    try:
        with tempfile.TemporaryDirectory() as alone:  # without rigs and frames: every image has its pose
            for name in ("cameras", "images", "points3D"):
                path = folder / f"{name}{ends[0]}"
                if path.suffix == ".bin" and name != "cameras" and path.is_file():
                    _check_counts(path)
                (Path(alone) / path.name).symlink_to(path.resolve())
            model.read(alone)
        for image in model.images.values():
            _ = image.name  # which need not be UTF-8
    except Exception as error:  # COLMAP's own of what they meet in a file
        reason = (str(error).strip().splitlines() or ["damaged"])[-1]
        if isinstance(error, UnicodeDecodeError):
            reason = f"an image's name is not UTF-8 ({error.object!r}); rename the photograph"
        raise UserError(
            f"the COLMAP model in {folder} cannot be read: {reason[:160]}; export it again"
        ) from error
    return model


def _check_counts(path: Path) -> None:
    """Walk through COLMAP's binary images or points; `ValueError` where it counts more than it holds, which COLMAP would allocate."""
    data = read_bytes(path, _MAX_MODEL_BYTES)

    def counted(at: int, bytes_each: int) -> int:
        return at + 8 + bytes_each * struct.unpack_from("<Q", data, at)[0]

    try:
        at = 8
        for _ in range(struct.unpack_from("<Q", data)[0]):
            if path.stem == "images":  # a name that ends in 0, and features
                at = counted(data.index(b"\0", at + 64) + 1, 24)
            else:
                at = counted(at + 43, 8)
            if at > len(data):
                raise ValueError
    except (ValueError, struct.error) as error:
        raise ValueError(f"{path.name} counts more than its {len(data)} bytes hold") from error


def solved_from_colmap(
    reconstruction: pycolmap.Reconstruction, name_of: Mapping[str, str], source: ImportSource
) -> SolvedModel:
    """What a COLMAP model says of the photographs that are there.

    ``name_of`` leads from the model's image names to the photographs' names; other images are left out. Its cameras may be
    of another size than the photographs, with the same sides' ratio.
    """
    reconstruction.update_point_3d_errors()
    ids = [i for i in sorted(reconstruction.reg_image_ids()) if reconstruction.image(i).name in name_of]
    row = {image_id: index for index, image_id in enumerate(ids)}
    names = tuple(name_of[reconstruction.image(i).name] for i in ids)
    poses = np.tile(np.eye(4), (len(ids), 1, 1))
    cameras, keypoints = [], []
    for index, image in enumerate(map(reconstruction.image, ids)):
        poses[index, :3] = image.cam_from_world().matrix()
        camera = pycolmap.Camera(reconstruction.camera(image.camera_id).todict())
        width_px, height_px = source.size_px(names[index])
        keypoints.append(np.array([p.xy for p in image.points2D]).reshape(-1, 2) * (width_px / camera.width))
        camera.rescale(width_px, height_px)
        cameras.append(camera)
    points: list[Any] = []
    observations: list[tuple[int, int]] = []
    xy: list[Any] = []
    for _, point in sorted(reconstruction.points3D.items()):
        seen = [(row[e.image_id], e.point2D_idx) for e in point.track.elements if e.image_id in row]
        if len({view for view, _ in seen}) >= 2:
            observations += [(len(points), view) for view, _ in seen]
            xy += [keypoints[view][feature] for view, feature in seen]
            points.append(point)
    of_point, of_view = np.array(observations, dtype=np.int64).reshape(-1, 2).T
    return SolvedModel(
        names,
        poses,
        tuple(cameras),
        np.array([p.xyz for p in points], dtype=float).reshape(-1, 3),
        np.array([p.color for p in points], dtype=np.uint8).reshape(-1, 3),
        of_point,
        of_view,
        np.array(xy, dtype=float).reshape(-1, 2),
        float(np.median([p.error for p in points])) if points else np.inf,
    )
