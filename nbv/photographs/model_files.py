"""Models that other programs made of the photographs: COLMAP, ``transforms.json``, Metashape, OpenSfM."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
import pycolmap

from nbv.errors import UserError
from nbv.geometry.frames import invert_rigid
from nbv.photographs.folder import SourcePhotograph, shrunk_size
from nbv.photographs.solved import SolvedModel, solved_from_colmap
from nbv.safe_files import RESULT_BYTES, RESULT_NODES, expanded, is_file, read_json, read_text
from nbv.types import Floats

_SAME_RATIO = 0.02  # of sides, relative, of a camera and its photograph
_MAX_MODEL_BYTES = 2 * 2**30
_LENS = ("k1", "k2", "p1", "p2", "k3")  # OpenCV's order


@dataclass(frozen=True)
class _Shot:
    """One photograph as another program places it."""

    file: str
    camera: pycolmap.Camera
    camera_from_model: Floats  # (4, 4)


def read_model(
    path: Path, photographs: Sequence[SourcePhotograph], max_size_px: int
) -> tuple[SolvedModel, bool]:
    """A model of the photographs, with points where it has tracks, and whether it sees them upright, as EXIF turns them.

    Parameters
    ----------
    path
        COLMAP's folder, or a file of ``transforms.json``, Metashape (XML) or OpenSfM (JSON).
    photographs
        Those of the set.
    max_size_px
        Long side at which they are worked on.

    Raises
    ------
    UserError
        It cannot be read, or is of other photographs.
    """
    path = expanded(path)
    by_file = {key: p for p in photographs for key in (p.path.stem.lower(), p.path.name.lower())}

    def find(file: str) -> SourcePhotograph | None:
        name = PurePosixPath(PureWindowsPath(file).as_posix()).name.lower()
        return by_file.get(name) or by_file.get(name.rpartition(".")[0])

    if path.is_dir():
        return _colmap(path, find, max_size_px)
    if not is_file(path):
        raise UserError(f"there is no model {path}; check --model")
    if path.suffix.lower() in (".bin", ".txt"):
        return _colmap(path.parent, find, max_size_px)
    try:
        shots = _metashape(path) if path.suffix.lower() == ".xml" else _json(path)
        return _placed(path, shots, find, max_size_px)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        reason = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else str(error)
        raise UserError(
            f"{path} cannot be read as a model ({reason[:100]}); export it again, or leave --model out"
        ) from error


Find = Callable[[str], SourcePhotograph | None]


def _colmap(folder: Path, find: Find, max_size_px: int) -> tuple[SolvedModel, bool]:
    ends = [
        e
        for e in (".bin", ".txt")
        if (folder / f"images{e}").is_file() and (folder / f"cameras{e}").is_file()
    ]
    if not ends:
        raise UserError(
            f"there is no COLMAP model in {folder}; it has cameras, images and points3D, .bin or .txt"
        )
    if any(p.stat().st_size > _MAX_MODEL_BYTES for p in folder.glob(f"*{ends[0]}")):
        raise UserError(f"the COLMAP model in {folder} is larger than 2 GB; leave --model out")
    reconstruction = pycolmap.Reconstruction()
    try:
        (reconstruction.read_binary if ends[0] == ".bin" else reconstruction.read_text)(folder)
    except Exception as error:  # COLMAP's own of what they meet in a file
        reason = str(error).strip().splitlines() or ["damaged"]
        raise UserError(f"the COLMAP model in {folder} cannot be read: {reason[-1][:120]}") from error
    images = [reconstruction.image(i) for i in sorted(reconstruction.reg_image_ids())]
    found = {image.name: photograph for image in images if (photograph := find(image.name)) is not None}
    upright = _is_upright(
        folder,
        [
            (
                found[i.name],
                reconstruction.camera(i.camera_id).width,
                reconstruction.camera(i.camera_id).height,
            )
            for i in images
            if i.name in found
        ],
        [image.name for image in images],
    )
    sizes = working_sizes(list(found.values()), max_size_px, upright=upright)
    return solved_from_colmap(reconstruction, {n: p.name for n, p in found.items()}, sizes), upright


def working_sizes(
    photographs: Sequence[SourcePhotograph], max_size_px: int, *, upright: bool
) -> dict[str, tuple[int, int]]:
    """Width and height at which each photograph is worked on, by name."""
    return {
        p.name: shrunk_size(p.upright_size_px if upright else p.size_px, max_size_px) for p in photographs
    }


def _is_upright(path: Path, found: Sequence[tuple[SourcePhotograph, int, int]], files: Sequence[str]) -> bool:
    """Whether the model's cameras have the photographs' sides as EXIF turns them; `UserError` if neither way."""
    if not found:
        raise UserError(
            f"{path} is a model of other photographs: none of its {len(files)} images "
            f"({', '.join(files[:2])}{', ...' if len(files) > 2 else ''}) is in the folder"
        )
    for upright in (True, False):
        sizes = [p.upright_size_px if upright else p.size_px for p, _, _ in found]
        if all(
            abs(w / h * size[1] / size[0] - 1) < _SAME_RATIO
            for (_, w, h), size in zip(found, sizes, strict=True)
        ):
            return upright
    photograph, width, height = found[0]
    raise UserError(
        f"{path} is a model of other photographs: it has {photograph.path.name} with {width} x {height} px, "
        f"the folder with {photograph.size_px[0]} x {photograph.size_px[1]}"
    )


def _placed(path: Path, shots: Sequence[_Shot], find: Find, max_size_px: int) -> tuple[SolvedModel, bool]:
    known = [(shot, photograph) for shot in shots if (photograph := find(shot.file)) is not None]
    upright = _is_upright(
        path, [(p, s.camera.width, s.camera.height) for s, p in known], [shot.file for shot in shots]
    )
    sizes = working_sizes([p for _, p in known], max_size_px, upright=upright)
    cameras, poses, names = [], [], []
    for shot, photograph in known:
        if photograph.name in names:
            continue
        camera = pycolmap.Camera(shot.camera.todict())
        camera.rescale(*sizes[photograph.name])
        cameras.append(camera)
        poses.append(_rigid(shot.camera_from_model, shot.file))
        names.append(photograph.name)
    no_index = np.zeros(0, dtype=np.int64)
    return (
        SolvedModel(
            tuple(names),
            np.array(poses),
            tuple(cameras),
            np.zeros((0, 3)),
            np.zeros((0, 3), np.uint8),
            no_index,
            no_index,
            np.zeros((0, 2)),
        ),
        upright,
    )


def _rigid(pose: Floats, file: str) -> Floats:
    rotation = pose[:3, :3]
    if not np.isfinite(pose).all() or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3:
        raise ValueError(f"the pose of {file} is not a rigid transform")
    u, _, vt = np.linalg.svd(rotation)
    out = pose.copy()
    out[:3, :3] = u @ vt
    return out


def _camera(
    width: Any, height: Any, focal: tuple[float, float], middle: tuple[float, float], lens: Mapping[str, Any]
) -> pycolmap.Camera:
    """A camera with OpenCV's lens; ``middle`` in pixels, centres at half-integers."""
    width, height = int(width), int(height)
    params = [*focal, *middle, *(float(lens.get(key, 0.0)) for key in _LENS), 0.0, 0.0, 0.0]
    if not (16 <= width <= 100_000 and 16 <= height <= 100_000) or min(focal) <= 0:
        raise ValueError(f"a camera of {width} x {height} px with focal length {focal[0]:g}")
    if not all(map(math.isfinite, params)):
        raise ValueError("a camera with numbers that are not finite")
    return pycolmap.Camera(model="FULL_OPENCV", width=width, height=height, params=params)


def _json(path: Path) -> list[_Shot]:
    tree = read_json(path, RESULT_BYTES, RESULT_NODES)
    if isinstance(tree, list):
        return _opensfm(tree)
    if isinstance(tree, dict) and "frames" in tree:
        return _transforms(tree)
    raise ValueError("it is neither transforms.json nor OpenSfM's reconstruction.json")


def _transforms(tree: Mapping[str, Any]) -> list[_Shot]:
    """NeRF's ``transforms.json``: model_from_camera with OpenGL's axes (y up, z backward)."""
    shots = []
    for frame in tree["frames"]:
        values = {**tree, **frame}
        width, height = float(values["w"]), float(values["h"])
        if "fl_x" in values:
            focal = (float(values["fl_x"]), float(values.get("fl_y", values["fl_x"])))
        else:
            focal = (0.5 * width / math.tan(0.5 * float(values["camera_angle_x"])),) * 2
        middle = (float(values.get("cx", width / 2)), float(values.get("cy", height / 2)))
        model_from_camera = np.array(frame["transform_matrix"], dtype=float) @ np.diag([1.0, -1.0, -1.0, 1.0])
        camera = _camera(width, height, focal, middle, values)
        shots.append(_Shot(str(frame["file_path"]), camera, invert_rigid(model_from_camera)))
    return shots


def _opensfm(tree: Sequence[Mapping[str, Any]]) -> list[_Shot]:
    """OpenSfM's ``reconstruction.json``, its largest model: lengths are shares of the longer side."""
    model = max(tree, key=lambda part: len(part["shots"]))
    cameras = {}
    for name, c in model["cameras"].items():
        width, height = float(c["width"]), float(c["height"])
        size = max(width, height)
        focal_x = size * float(c.get("focal_x", c.get("focal", 0.0)))
        focal_y = size * float(c.get("focal_y", c.get("focal", 0.0)))
        middle = (width / 2 + size * float(c.get("c_x", 0.0)), height / 2 + size * float(c.get("c_y", 0.0)))
        cameras[name] = _camera(width, height, (focal_x, focal_y), middle, c)
    shots = []
    for file, shot in model["shots"].items():
        pose = np.eye(4)
        pose[:3, :3] = cv2.Rodrigues(np.array(shot["rotation"], dtype=float))[0]
        pose[:3, 3] = np.array(shot["translation"], dtype=float)
        shots.append(_Shot(file, cameras[shot["camera"]], pose))
    return shots


def _metashape(path: Path) -> list[_Shot]:
    """Metashape's camera export: model_from_camera with OpenCV's axes; its p1 and p2 are OpenCV's p2 and p1."""
    text = read_text(path, RESULT_BYTES)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError("it declares entities, which no camera export does")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ValueError(str(error)) from error
    cameras = {}
    for sensor in root.iter("sensor"):
        calibration = next(
            (c for c in sensor.iter("calibration") if c.get("class") == "adjusted"),
            sensor.find("calibration"),
        )
        if calibration is None:
            continue
        values = {child.tag: float(child.text) for child in calibration if child.text and child.text.strip()}
        size = calibration.find("resolution")
        size = sensor.find("resolution") if size is None else size
        if size is None or "f" not in values:
            continue
        width, height = float(size.get("width", 0)), float(size.get("height", 0))
        lens = {**values, "p1": values.get("p2", 0.0), "p2": values.get("p1", 0.0)}
        middle = (width / 2 + values.get("cx", 0.0), height / 2 + values.get("cy", 0.0))
        cameras[sensor.get("id")] = _camera(width, height, (values["f"],) * 2, middle, lens)
    shots = []
    for element in root.iter("camera"):
        transform = element.find("transform")
        if transform is None or not transform.text or element.get("sensor_id") not in cameras:
            continue
        matrix = np.array([float(word) for word in transform.text.split()]).reshape(4, 4)
        shots.append(_Shot(element.get("label", ""), cameras[element.get("sensor_id")], invert_rigid(matrix)))
    if not shots:
        raise ValueError("it has no aligned camera")
    return shots
