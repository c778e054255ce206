"""Models that other programs made of the photographs: COLMAP, ``transforms.json``, Metashape, OpenSfM."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
import pycolmap

from nbv.errors import UserError
from nbv.geometry.frames import invert_rigid
from nbv.photographs.solved import SolvedModel, solved_from_colmap
from nbv.photographs.source import Source
from nbv.safe_files import RESULT_BYTES, RESULT_NODES, expanded, is_file, read_json, read_text
from nbv.types import Floats

_SAME_RATIO = 0.02  # of sides, relative, of a camera and its photograph
_MAX_MODEL_BYTES = 2 * 2**30
_LENS = ("k1", "k2", "p1", "p2", "k3")  # OpenCV's order


def read_model(path: Path, source: Source) -> tuple[SolvedModel, Source]:
    """A model of the photographs, with points where it has tracks, and the photographs as it sees them: upright or not.

    ``path`` is COLMAP's folder, or a file of ``transforms.json``, Metashape (XML) or OpenSfM (JSON).

    Raises
    ------
    UserError
        It cannot be read, or is of other photographs.
    """
    path = expanded(path)
    if path.is_dir():
        return _of_photographs(_colmap(path), path, source)
    if not is_file(path):
        raise UserError(f"there is no model {path}; check --model")
    if path.suffix.lower() in (".bin", ".txt"):
        return _of_photographs(_colmap(path.parent), path.parent, source)
    try:
        model = _metashape(path) if path.suffix.lower() == ".xml" else _json(path)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        reason = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else str(error)
        raise UserError(
            f"{path} cannot be read as a model ({reason[:100]}); export it again, or leave --model out"
        ) from error
    return _of_photographs(model, path, source)


def _of_photographs(model: pycolmap.Reconstruction, path: Path, source: Source) -> tuple[SolvedModel, Source]:
    """What the model says of the photographs, which are found by their files' names, with suffix or without."""
    by_file = {key: p.name for p in source.photographs for key in (p.path.stem.lower(), p.path.name.lower())}
    images = {model.image(i).name: model.image(i) for i in sorted(model.reg_image_ids())}
    name_of: dict[str, str] = {}
    for name in images:
        file = PurePosixPath(PureWindowsPath(name).as_posix()).name.lower()
        found = by_file.get(file) or by_file.get(file.rpartition(".")[0])
        if found is not None and found not in name_of.values():
            name_of[name] = found
    if not name_of:
        raise UserError(
            f"{path} is a model of other photographs: none of its {len(images)} images "
            f"({', '.join(list(images)[:2])}{', ...' if len(images) > 2 else ''}) is in the folder"
        )
    cameras = {name: model.camera(images[file].camera_id) for file, name in name_of.items()}
    for upright in (True, False):
        seen = replace(source, upright=upright)
        sizes = {name: seen.full_size_px(name) for name in cameras}
        if all(
            abs(c.width / c.height * sizes[name][1] / sizes[name][0] - 1) < _SAME_RATIO
            for name, c in cameras.items()
        ):
            return solved_from_colmap(model, name_of, seen), seen
    name, camera = next(iter(cameras.items()))
    photograph = source.by_name[name]
    raise UserError(
        f"{path} is a model of other photographs: it has {photograph.path.name} with {camera.width} x {camera.height} px, "
        f"the folder with {photograph.size_px[0]} x {photograph.size_px[1]}"
    )


def _colmap(folder: Path) -> pycolmap.Reconstruction:
    ends = [e for e in (".bin", ".txt") if all((folder / f"{n}{e}").is_file() for n in ("images", "cameras"))]
    if not ends:
        raise UserError(
            f"there is no COLMAP model in {folder}; it has cameras, images and points3D, .bin or .txt"
        )
    if any(p.stat().st_size > _MAX_MODEL_BYTES for p in folder.glob(f"*{ends[0]}")):
        raise UserError(f"the COLMAP model in {folder} is larger than 2 GB; leave --model out")
    model = pycolmap.Reconstruction()
    try:
        (model.read_binary if ends[0] == ".bin" else model.read_text)(folder)
    except Exception as error:  # COLMAP's own of what they meet in a file
        reason = str(error).strip().splitlines() or ["damaged"]
        raise UserError(f"the COLMAP model in {folder} cannot be read: {reason[-1][:120]}") from error
    return model


def _add(
    model: pycolmap.Reconstruction, file: str, camera: pycolmap.Camera, camera_from_model: Floats
) -> None:
    """Enter one photograph, ``file``, as another program places it."""
    pose = camera_from_model[:3].copy()
    if not np.isfinite(pose).all() or np.abs(pose[:, :3] @ pose[:, :3].T - np.eye(3)).max() > 1e-3:
        raise ValueError(f"the pose of {file} is not a rigid transform")
    u, _, vt = np.linalg.svd(pose[:, :3])
    pose[:, :3] = u @ vt
    number = model.num_images() + 1
    camera = pycolmap.Camera({**camera.todict(), "camera_id": number})
    model.add_camera_with_trivial_rig(camera)
    image: Any = pycolmap.Image(name=file, keypoints=np.zeros((0, 2)), camera_id=number, image_id=number)
    model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose))


def _camera(
    size_px: tuple[Any, Any],
    focal_px: tuple[float, float],
    middle_px: tuple[float, float],
    lens: Mapping[str, Any],
) -> pycolmap.Camera:
    """A camera with OpenCV's lens; ``middle_px`` with pixel centres at half-integers."""
    width, height = map(int, size_px)
    params = [*focal_px, *middle_px, *(float(lens.get(key, 0.0)) for key in _LENS), 0.0, 0.0, 0.0]
    if not (16 <= width <= 100_000 and 16 <= height <= 100_000) or min(focal_px) <= 0:
        raise ValueError(f"a camera of {width} x {height} px with focal length {focal_px[0]:g}")
    if not all(map(math.isfinite, params)):
        raise ValueError("a camera with numbers that are not finite")
    return pycolmap.Camera(model="FULL_OPENCV", width=width, height=height, params=params)


def _json(path: Path) -> pycolmap.Reconstruction:
    tree = read_json(path, RESULT_BYTES, RESULT_NODES)
    if isinstance(tree, list):
        return _opensfm(tree)
    if isinstance(tree, dict) and "frames" in tree:
        return _transforms(tree)
    raise ValueError("it is neither transforms.json nor OpenSfM's reconstruction.json")


def _transforms(tree: Mapping[str, Any]) -> pycolmap.Reconstruction:
    """NeRF's ``transforms.json``: model_from_camera with OpenGL's axes (y up, z backward)."""
    model = pycolmap.Reconstruction()
    for frame in tree["frames"]:
        values = {**tree, **frame}
        width, height = float(values["w"]), float(values["h"])
        if "fl_x" in values:
            focal = (float(values["fl_x"]), float(values.get("fl_y", values["fl_x"])))
        else:
            focal = (0.5 * width / math.tan(0.5 * float(values["camera_angle_x"])),) * 2
        middle = (float(values.get("cx", width / 2)), float(values.get("cy", height / 2)))
        model_from_camera = np.array(frame["transform_matrix"], dtype=float) @ np.diag([1.0, -1.0, -1.0, 1.0])
        camera = _camera((width, height), focal, middle, values)
        _add(model, str(frame["file_path"]), camera, invert_rigid(model_from_camera))
    return model


def _opensfm(tree: Sequence[Mapping[str, Any]]) -> pycolmap.Reconstruction:
    """OpenSfM's ``reconstruction.json``, its largest model: lengths are shares of the longer side."""
    model, largest, cameras = pycolmap.Reconstruction(), max(tree, key=lambda part: len(part["shots"])), {}
    for name, c in largest["cameras"].items():
        width, height = float(c["width"]), float(c["height"])
        size = max(width, height)
        fx, fy = (size * float(c.get(f"focal_{axis}", c.get("focal", 0.0))) for axis in "xy")
        middle = (width / 2 + size * float(c.get("c_x", 0.0)), height / 2 + size * float(c.get("c_y", 0.0)))
        cameras[name] = _camera((width, height), (fx, fy), middle, c)
    for file, shot in largest["shots"].items():
        pose = np.eye(4)
        pose[:3, :3] = cv2.Rodrigues(np.array(shot["rotation"], dtype=float))[0]
        pose[:3, 3] = np.array(shot["translation"], dtype=float)
        _add(model, file, cameras[shot["camera"]], pose)
    return model


def _metashape(path: Path) -> pycolmap.Reconstruction:
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
        found = sensor.find("calibration[@class='adjusted']")
        calibration = sensor.find("calibration") if found is None else found
        size = sensor.find(".//resolution")
        if size is None or calibration is None or calibration.find("f") is None:
            continue
        values = {child.tag: float(child.text) for child in calibration if child.text and child.text.strip()}
        width, height = float(size.get("width", 0)), float(size.get("height", 0))
        lens = {**values, "p1": values.get("p2", 0.0), "p2": values.get("p1", 0.0)}
        middle = (width / 2 + values.get("cx", 0.0), height / 2 + values.get("cy", 0.0))
        cameras[sensor.get("id")] = _camera((width, height), (values["f"],) * 2, middle, lens)
    model = pycolmap.Reconstruction()
    for element in root.iter("camera"):
        matrix, camera = element.findtext("transform"), cameras.get(element.get("sensor_id"))
        if matrix and camera is not None:
            pose = np.array([float(word) for word in matrix.split()]).reshape(4, 4)
            _add(model, element.get("label", ""), camera, invert_rigid(pose))
    if not model.num_images():
        raise ValueError("it has no aligned camera")
    return model
