"""Models that other programs made of the photographs: COLMAP's and ``transforms.json``."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2  # noqa: F401  before pycolmap: the other order aborts the process when cv2 writes a PNG
import numpy as np
import pycolmap

from nbv.errors import UserError
from nbv.geometry.frames import invert_rigid
from nbv.photographs.folder import MIRRORED, files_of_photographs
from nbv.photographs.import_source import ImportSource
from nbv.photographs.solved import SolvedModel, solved_from_colmap
from nbv.safe_files import RESULT_BYTES, RESULT_NODES, expanded, is_file, read_bytes, read_json

_SIZES = ("upright_size_px", "size_px")  # of a photograph that is turned as EXIF says, and as stored
_SAME_RATIO = 0.02  # of sides, relative, of a camera and its photograph
_MAX_MODEL_BYTES = 2 * 2**30
_MAX_SIDE_PX = 100_000
# Of ``camera_model`` in transforms.json: polynomials of which OpenCV's is the longest.
_PERSPECTIVE = ("", "PERSPECTIVE", "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
_POSE_KEYS = {"file_path", "transform_matrix", "frames", "camera_model", "is_fisheye"}
_FOCAL = {"fl_x", "fl_y", "camera_angle_x", "camera_angle_y"}
_SAME_FOCAL = 0.02  # relative, of fl_x and what camera_angle_x says
FOCAL_SIDES = (0.05, 200.0)  # focal lengths that lenses have, in long sides of the picture
FOCAL_RATIO = 2.5  # of fl_x and fl_y, at most: pixels of anamorphic lenses
# Values that say nothing of a plain camera; the first four also not where there is distortion.
_HARMLESS = ("perspective", "false", "no", "off", "none", "null", "pinhole")
# Keys that may change where a point is seen: they are used, or they are refused.
_LENS_KEY = re.compile(
    r"(k|p|b|s|sx|sy|c|d)_?\d*|skew|alpha|beta|xi|omega|.*(fov|radial|tangential|distort|dist_|lens|fish|theta|omni|spher|equirect|latlong|"
    r"ortho|projection|camera_type|model_type|shutter|stereo|vr180|principal|focal).*"
)


def read_model(path: Path, source: ImportSource) -> tuple[list[tuple[SolvedModel, ImportSource]], list[str]]:
    """A model of the photographs, with points where it has tracks, and the photographs as it may see them; notes.

    ``path`` is COLMAP's folder or ``transforms.json``. A file does not say whether its photographs were turned as EXIF says: where
    their sizes do not tell either, there are several answers. `UserError` where it cannot be read, or is of other photographs.
    """
    path = expanded(path)
    if path.is_dir():
        return _of_photographs(_colmap(path), path, source), []
    if not is_file(path):
        raise UserError(f"there is no model {path}; check --model")
    if path.suffix.lower() in (".bin", ".txt"):
        return _of_photographs(_colmap(path.parent), path.parent, source), []
    tree = read_json(path, RESULT_BYTES, RESULT_NODES) if path.suffix.lower() == ".json" else None
    if not isinstance(tree, dict) or "frames" not in tree:
        raise UserError(
            f"{path} is neither transforms.json nor a COLMAP model; export one and give its folder (Metashape: File > "
            "Export > Export Cameras as Colmap; OpenSfM: bin/opensfm export_colmap DATASET)"
        )
    answers: list[tuple[SolvedModel, ImportSource]] = []
    try:
        images = [str(frame["file_path"]) for frame in tree["frames"]]
        if not (files := files_of_photographs(images, source.photographs, str(path))):
            raise _of_others(path, images)
        turned = {size: {f: getattr(source.by_name[n], size) for n, f in files.items()} for size in _SIZES}
        sized = all({"w", "h"} <= tree.keys() | frame.keys() for frame in tree["frames"])
        wrong: ValueError | None = None
        for size in _SIZES[: 1 if sized or turned[_SIZES[0]] == turned[_SIZES[1]] else None]:
            try:
                model, unread = _transforms(tree, turned[size])
                answers += _of_photographs(model, path, source)
            except ValueError as error:  # such as pixels outside a picture that is held the other way
                wrong = wrong or error
        if wrong is not None and not answers:
            raise wrong
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, ArithmeticError) as error:
        reason = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else str(error)
        raise UserError(
            f"{path} cannot be read as a model ({reason[:160]}); export it again, or leave --model out"
        ) from error
    return answers, [f"{path.name}: not read: {', '.join(sorted(unread))}"] if unread else []


def _of_photographs(
    model: pycolmap.Reconstruction, path: Path, source: ImportSource
) -> list[tuple[SolvedModel, ImportSource]]:
    """What the model says of the photographs, turned as EXIF says or not, as their sizes allow."""
    images = {model.image(i).name: model.image(i) for i in sorted(model.reg_image_ids())}
    found = files_of_photographs(images, source.photographs, str(path))
    if not found:
        raise _of_others(path, list(images))
    name_of = {file: name for name, file in found.items()}
    cameras = {name: model.camera(images[file].camera_id) for file, name in name_of.items()}
    for name, camera in cameras.items():
        if wrong := _wrong(camera):
            raise UserError(f"{path} cannot be read: {wrong} (of {found[name]}); export it again")
    turns = {source.by_name[name].orientation for name in cameras}
    answers = []
    for upright in (True, False) if turns != {1} else (True,):
        seen = replace(source, upright=upright)
        sizes = {name: seen.full_size_px(name) for name in cameras}
        if all(
            abs(c.width / c.height * sizes[name][1] / sizes[name][0] - 1) < _SAME_RATIO
            for name, c in cameras.items()
        ):
            solved = solved_from_colmap(model, name_of, seen)
            if not (np.isfinite(solved.poses).all() and np.isfinite(solved.xyz).all()):
                raise UserError(f"{path} has poses or points that are not finite; export it again")
            mirrored = not upright and turns <= set(MIRRORED)
            answers.append((solved.mirrored() if mirrored else solved, seen))
    if answers:
        return answers
    name, camera = next(iter(cameras.items()))
    photograph = source.by_name[name]
    raise UserError(
        f"{path} is a model of other photographs: it has {photograph.path.name} with {camera.width} x {camera.height} px, "
        f"the folder with {photograph.size_px[0]} x {photograph.size_px[1]}"
    )


def _of_others(path: Path, images: Sequence[str]) -> UserError:
    return UserError(
        f"{path} is a model of other photographs: none of its {len(images)} images "
        f"({', '.join(images[:2])}{', ...' if len(images) > 2 else ''}) is in the folder"
    )


def _wrong(camera: pycolmap.Camera) -> str:
    """What keeps a camera from being one, or nothing."""
    size = f"{camera.width} x {camera.height} px"
    if not all(1 <= side <= _MAX_SIDE_PX for side in (camera.width, camera.height)):
        return f"a camera of {size}"
    if camera.is_spherical():
        return f"a camera {camera.model_name}, of which no perspective picture can be made"
    if not np.isfinite(camera.params).all() or not camera.verify_params():
        return f"a camera {camera.model_name} with numbers that are not finite"
    focal = [float(camera.params[i]) for i in camera.focal_length_idxs()]
    low, high = (sides * max(camera.width, camera.height) for sides in FOCAL_SIDES)
    if not (low <= min(focal) and max(focal) <= min(high, FOCAL_RATIO * min(focal))):
        return f"a camera of {size} with focal length {' and '.join(f'{f:g}' for f in focal)} px"
    x, y = (float(camera.params[i]) for i in camera.principal_point_idxs())
    if not (0 < x < camera.width and 0 < y < camera.height):
        return f"a camera of {size} with its principal point at ({x:g}, {y:g}), outside the picture"
    return ""


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
        if ends[0] == ".bin":
            for path in folder.glob("*.bin"):
                _check_counts(path)
            model.read_binary(folder)
        else:
            model.read_text(folder)
        for image in model.images.values():
            _ = image.name  # which need not be UTF-8
    except UnicodeDecodeError as error:
        raise UserError(
            f"the COLMAP model in {folder} has an image whose name is not UTF-8 ({error.object!r}); rename the photograph, "
            "and export it again"
        ) from error
    except Exception as error:  # COLMAP's own of what they meet in a file
        reason = str(error).strip().splitlines() or ["damaged"]
        raise UserError(f"the COLMAP model in {folder} cannot be read: {reason[-1][:120]}") from error
    return model


def _check_counts(path: Path) -> None:
    """Walk through one of COLMAP's binary files; ValueError where it counts more than it holds, which COLMAP would allocate."""
    data = read_bytes(path, _MAX_MODEL_BYTES)

    def counted(at: int, bytes_each: int) -> int:
        return at + 8 + bytes_each * struct.unpack_from("<Q", data, at)[0]

    def camera(at: int) -> int:
        model = pycolmap.CameraModelId(struct.unpack_from("<i", data, at + 4)[0])
        return at + 24 + 8 * len(pycolmap.Camera.create_from_model_id(1, model, 1.0, 1, 1).params)

    def rig(at: int) -> int:
        sensors, at = struct.unpack_from("<I", data, at + 4)[0], at + 8 + 8
        for _ in range(sensors - 1):
            at += 65 if data[at + 8] else 9
        return at if sensors else at - 8

    walks = {
        "cameras": camera,
        "images": lambda at: counted(data.find(b"\0", at + 64) % (len(data) + 1) + 1, 24),
        "points3D": lambda at: counted(at + 43, 8),
        "rigs": rig,
        "frames": lambda at: at + 68 + 16 * struct.unpack_from("<I", data, at + 64)[0],
    }
    if (walk := walks.get(path.stem)) is None:
        return
    try:
        at = 8
        for _ in range(struct.unpack_from("<Q", data)[0]):
            at = walk(at)
            if at > len(data):
                raise IndexError
    except (IndexError, struct.error) as error:
        raise ValueError(f"{path.name} counts more than its {len(data)} bytes hold") from error


def _transforms(
    tree: Mapping[str, Any], size_px: Mapping[str, tuple[int, int]]
) -> tuple[pycolmap.Reconstruction, set[str]]:
    """NeRF's ``transforms.json``, and which of its keys were not read: model_from_camera with OpenGL's axes (y up, z backward).

    ``size_px`` are the sizes of the photographs that its files are, for frames without ``w`` and ``h``.
    """
    model, unread = pycolmap.Reconstruction(), set[str]()
    for number, frame in enumerate(tree["frames"], start=1):
        values = _values(tree, frame)
        if not {"w", "h"} <= values.keys():
            if frame["file_path"] not in size_px:
                continue  # of another photograph
            values["w"], values["h"] = size_px[frame["file_path"]]
        camera, used = _camera(values)
        camera.camera_id = number
        unread |= {key for key in values if key not in used | _POSE_KEYS}
        matrix = np.array(frame["transform_matrix"], dtype=float)
        if matrix.shape not in ((3, 4), (4, 4)):
            raise ValueError(f"the pose of {frame['file_path']} is not a matrix of 4 x 4")
        pose = invert_rigid(matrix @ np.diag([1.0, -1.0, -1.0, 1.0]))[:3]
        turn = pose[:, :3]
        if (
            not np.isfinite(pose).all()
            or np.abs(turn @ turn.T - np.eye(3)).max() > 1e-3
            or np.linalg.det(turn) < 0
        ):
            raise ValueError(f"the pose of {frame['file_path']} is not a rigid transform")
        u, _, vt = np.linalg.svd(turn)
        rigid = pycolmap.Rigid3d(np.column_stack([u @ vt, pose[:, 3]]))
        model.add_camera_with_trivial_rig(camera)
        image: Any = pycolmap.Image(
            name=str(frame["file_path"]), keypoints=np.zeros((0, 2)), camera_id=number, image_id=number
        )
        model.add_image_with_trivial_frame(image, rigid)
    return model, unread


def _values(tree: Mapping[str, Any], frame: Mapping[str, Any]) -> dict[str, Any]:
    """What holds for a frame: its focal length is its own or the file's, never a mixture, and pixels are of its size."""
    own = _FOCAL & frame.keys()
    values = {key: value for key, value in tree.items() if not (own and key in _FOCAL)} | dict(frame)
    if any(values.get(side) != tree.get(side, values.get(side)) for side in ("w", "h")):
        for key in ("fl_x", "fl_y", "cx", "cy"):
            if key in values and key not in frame:
                raise ValueError(f"{frame['file_path']} has a size of its own, but no {key} of its own")
    return values


def _camera(values: Mapping[str, Any]) -> tuple[pycolmap.Camera, set[str]]:
    """The camera of a frame, and which keys say it. ValueError where COLMAP has no model of it."""
    kind = str(values.get("camera_model") or "").upper()
    if str(values.get("is_fisheye", "")).lower() not in ("", "0", "false", "none"):
        kind = "OPENCV_FISHEYE" if kind in ("", "OPENCV", "OPENCV_FISHEYE") else f"{kind} that is a fisheye"
    kind = "FULL_OPENCV" if (full := kind in _PERSPECTIVE) else kind
    if kind not in pycolmap.CameraModelId.__members__ or kind == "INVALID":
        raise ValueError(f"camera_model {kind} is none of COLMAP's")
    width, height = float(values["w"]), float(values["h"])
    if not all(1 <= side <= _MAX_SIDE_PX for side in (width, height)):
        raise ValueError(f"a camera of {width:g} x {height:g} px")
    angles = {}
    for key, side in (("camera_angle_x", width), ("camera_angle_y", height)):
        if key in values and (full or kind == "FULL_OPENCV"):
            if not 0 < float(values[key]) < math.pi:
                raise ValueError(f"{key} is {values[key]}; it lies between 0 and pi")
            angles[key] = 0.5 * side / math.tan(0.5 * float(values[key]))
    focal_x = float(values["fl_x"] if "fl_x" in values else angles.get("camera_angle_x") or values["fl_x"])
    focal_y = float(
        values.get("fl_y", focal_x if "fl_x" in values else angles.get("camera_angle_y", focal_x))
    )
    camera = pycolmap.Camera.create_from_model_name(1, kind, focal_x, int(width), int(height))
    for key, angle, focal in (("fl_x", "camera_angle_x", focal_x), ("fl_y", "camera_angle_y", focal_y)):
        if key in values and angle in angles and abs(focal / angles[angle] - 1) > _SAME_FOCAL:
            raise ValueError(f"{key} is {focal:g}, but {angle} says {angles[angle]:g}")
    names = camera.params_info.replace(" ", "").split(",")
    if "f" in names and focal_x != focal_y:
        raise ValueError(f"fl_y is not fl_x, but camera_model {kind} has one focal length")
    if full:
        names = names[:9]  # what other programs call k4 is no denominator, as OpenCV's is
    given = {
        "fx": focal_x,
        "fy": focal_y,
        "f": focal_x,
        "cx": float(values.get("cx", width / 2)),
        "cy": float(values.get("cy", height / 2)),
        "k": float(values.get("k1", 0.0)),
    }
    params = [
        float(given[n] if n in given else values.get(n, 0.0) if n[0] in "kps" else values[n]) for n in names
    ]
    camera.params = np.pad(params, (0, len(camera.params) - len(params)))
    used = {*names, "w", "h"} - {"f", "fx", "fy"} | _FOCAL | ({"k1"} if "k" in names else set())
    bent = any(v for n, v in zip(names, params, strict=True) if n[0] in "kps")
    for key, value in values.items():
        if full and str(value).lower() in _HARMLESS[: 4 if bent and "dist" in key.lower() else None]:
            continue
        if key not in used | _POSE_KEYS and _LENS_KEY.fullmatch(key.lower()) and any(np.ravel(value)):
            raise ValueError(f"{key} is {str(value)[:40]}, and COLMAP's {kind} has no such parameter")
    if wrong := _wrong(camera):
        raise ValueError(wrong)
    return camera, used
