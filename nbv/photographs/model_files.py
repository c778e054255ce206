"""Models that other programs made of the photographs: COLMAP's and ``transforms.json``."""

from __future__ import annotations

import math
import re
import struct
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2  # noqa: F401  before pycolmap: the other order aborts the process when cv2 writes a PNG
import numpy as np
import pycolmap

from nbv.errors import UserError
from nbv.geometry.frames import invert_rigid
from nbv.photographs.folder import MIRRORED, files_of_photographs
from nbv.photographs.import_source import SAME_RATIO, ImportSource
from nbv.photographs.solved import SolvedModel, solved_from_colmap
from nbv.safe_files import RESULT_BYTES, expanded, is_file, read_bytes, read_json

_MAX_MODEL_BYTES = 2 * 2**30
_MAX_LINE_BYTES = 10 * 2**20  # of a text, which COLMAP unpacks seventyfold
_MAX_SIDE_PX = 100_000
FEWEST_POSES = 3
# Of ``camera_model`` in transforms.json: polynomials of which OpenCV's is the longest.
_PERSPECTIVE = ("", "PERSPECTIVE", "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
_FOCAL = {"fl_x", "fl_y", "camera_angle_x", "camera_angle_y"}
# Keys of transforms.json that say nothing of where a point is seen; others than these and the lens's are refused.
_HARMLESS = re.compile(
    r"file_path|transform_matrix|frames|w|h|camera_model|is_fisheye|aabb(_scale)?|scale|offset|up|centroid|totp|sharpness|rotation|"
    r"applied_(transform|scale)|ply_file_path|colmap_im_id|(depth_file|mask)_path|(train|val|test)_filenames|orientation_override|"
    r"time(stamp)?"
)
_SAME_FOCAL = 0.02  # relative, of fl_x and what camera_angle_x says
FOCAL_SIDES = (0.05, 200.0)  # focal lengths that lenses have, in long sides of the picture
FOCAL_RATIO = 2.5  # of fl_x and fl_y, at most: pixels of anamorphic lenses


def read_model(path: Path, source: ImportSource) -> list[tuple[SolvedModel, ImportSource]]:
    """A model, with points where it has tracks, and the photographs as it may see them: turned as EXIF says, or not, or either.

    ``path`` is COLMAP's folder or ``transforms.json``. `UserError` where it cannot be read, or is of other photographs.
    """
    path = expanded(path)
    if path.is_dir():
        return _of_photographs(_colmap(path), path, source)
    if not is_file(path):
        raise UserError(f"there is no model {path}; check --model")
    if path.suffix.lower() in (".bin", ".txt"):
        return _of_photographs(_colmap(path.parent), path.parent, source)
    tree = read_json(path, RESULT_BYTES) if path.suffix.lower() == ".json" else None
    if not isinstance(tree, dict) or "frames" not in tree:
        raise UserError(
            f"{path} is neither transforms.json nor a COLMAP model; export one and give its folder (Metashape: File > "
            "Export > Export Cameras as Colmap; OpenSfM: bin/opensfm export_colmap DATASET)"
        )
    try:
        model = _transforms(_with_sizes(tree, path, source))
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, ArithmeticError) as error:
        reason = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else str(error)
        raise UserError(
            f"{path} cannot be read as a model ({reason[:160]}); export it again, or leave --model out"
        ) from error
    return _of_photographs(model, path, source)


def _of_photographs(
    model: pycolmap.Reconstruction, path: Path, source: ImportSource
) -> list[tuple[SolvedModel, ImportSource]]:
    """What the model says of the photographs, turned as EXIF says or not, as their sizes allow."""
    images = {model.image(i).name: model.image(i) for i in sorted(model.reg_image_ids())}
    file_of = files_of_photographs(images, source.photographs, str(path))
    if not file_of:
        raise UserError(
            f"{path} is a model of other photographs: none of its {len(images)} images "
            f"({', '.join(list(images)[:2])}{', ...' if len(images) > 2 else ''}) is in the folder"
        )
    name_of = {file: name for name, file in file_of.items()}
    cameras = {name: model.camera(images[file].camera_id) for file, name in name_of.items()}
    for name, camera in cameras.items():
        if wrong := _wrong(camera):
            raise UserError(f"{path} cannot be read: {wrong} (of {file_of[name]}); export it again")
    turns = {source.by_name[name].orientation for name in cameras}
    answers = []
    for upright in (True, False) if turns != {1} else (True,):
        seen = replace(source, upright=upright)
        sizes = {name: seen.full_size_px(name) for name in cameras}
        if all(
            abs(c.width / c.height * sizes[name][1] / sizes[name][0] - 1) < SAME_RATIO
            for name, c in cameras.items()
        ):
            solved = solved_from_colmap(model, name_of, seen)
            if not (np.isfinite(solved.poses).all() and np.isfinite(solved.xyz).all()):
                raise UserError(f"{path} has poses or points that are not finite; export it again")
            mirrored = not upright and turns <= set(MIRRORED)
            answers.append((solved.mirrored() if mirrored else solved, seen))
    if not answers:
        name, camera = next(iter(cameras.items()))
        photograph = source.by_name[name]
        raise UserError(
            f"{path} is a model of other photographs: it has {photograph.path.name} with {camera.width} x {camera.height} px, "
            f"the folder with {photograph.size_px[0]} x {photograph.size_px[1]}"
        )
    if len(file_of) < FEWEST_POSES:
        raise UserError(
            f"{path} has the poses of {len(file_of)} of the {len(source.photographs)} photographs; {FEWEST_POSES} or more are "
            "needed: export it again, or leave --model out"
        )
    return answers


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
    model = pycolmap.Reconstruction()
    try:
        with tempfile.TemporaryDirectory() as alone:  # without rigs and frames: every image has its pose
            for name in ("cameras", "images", "points3D"):
                path = folder / f"{name}{ends[0]}"
                if path.suffix == ".bin" and name != "cameras" and path.is_file():
                    _check_counts(path)
                if path.suffix == ".txt" and path.is_file():
                    _check_lines(path)
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


def _check_lines(path: Path) -> None:
    with path.open("rb") as file:
        while line := file.readline(_MAX_LINE_BYTES + 1):
            if len(line) > _MAX_LINE_BYTES:
                raise ValueError(f"{path.name} has a line of more than {_MAX_LINE_BYTES / 2**20:.0f} MB")


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


def _with_sizes(tree: Mapping[str, Any], path: Path, source: ImportSource) -> Mapping[str, Any]:
    """The tree with the photographs' sizes where it has none, as NeRF's own files: as programs read them, turned upright."""
    bare = [str(frame["file_path"]) for frame in tree["frames"] if not {"w", "h"} <= {*tree, *frame}]
    if not bare:
        return tree
    file_of = files_of_photographs(bare, source.photographs, str(path))
    if not file_of:
        raise ValueError("it has no 'w' and 'h', and names none of the photographs")
    sizes: dict[str, Any] = dict.fromkeys(bare)
    sizes |= {file: source.by_name[name].upright_size_px for name, file in file_of.items()}
    frames = [{**dict(zip("wh", sizes.get(str(f["file_path"])) or ())), **f} for f in tree["frames"]]
    # Frames without a size are not in the folder.
    return {**tree, "frames": [f for f in frames if {"w", "h"} <= {*tree, *f}]}


def _transforms(tree: Mapping[str, Any]) -> pycolmap.Reconstruction:
    """NeRF's ``transforms.json``: model_from_camera with OpenGL's axes (y up, z backward)."""
    model = pycolmap.Reconstruction()
    for number, frame in enumerate(tree["frames"], start=1):
        values, name = _values(tree, frame), str(frame["file_path"])
        camera = _camera(values)
        camera.camera_id = number
        matrix = np.array(frame["transform_matrix"], dtype=float)
        if matrix.shape not in ((3, 4), (4, 4)):
            raise ValueError(f"the pose of {name} is not a matrix of 4 x 4")
        pose = invert_rigid(matrix @ np.diag([1.0, -1.0, -1.0, 1.0]))[:3]
        turn = pose[:, :3]
        off = np.abs(turn @ turn.T - np.eye(3)).max()
        if not np.isfinite(pose).all() or off > 1e-3 or np.linalg.det(turn) < 0:
            raise ValueError(f"the pose of {name} is not a rigid transform")
        u, _, vt = np.linalg.svd(turn)
        rigid = pycolmap.Rigid3d(np.column_stack([u @ vt, pose[:, 3]]))
        model.add_camera_with_trivial_rig(camera)
        image: Any = pycolmap.Image(name=name, keypoints=np.zeros((0, 2)), camera_id=number, image_id=number)
        model.add_image_with_trivial_frame(image, rigid)
    return model


def _values(tree: Mapping[str, Any], frame: Mapping[str, Any]) -> dict[str, Any]:
    """What holds for a frame: its focal length is its own or the file's, never a mixture, and pixels are of its size."""
    frames_focal = _FOCAL & frame.keys()
    values = {key: value for key, value in tree.items() if not (frames_focal and key in _FOCAL)} | dict(frame)
    if any(values.get(side) != tree.get(side, values.get(side)) for side in ("w", "h")):
        for key in ("fl_x", "fl_y", "cx", "cy"):
            if key in values and key not in frame:
                raise ValueError(f"{frame['file_path']} has a size of its own, but no {key} of its own")
    return values


def _camera(values: Mapping[str, Any]) -> pycolmap.Camera:
    """The camera of a frame; `ValueError` where COLMAP has no model of it, or a key may say more of it than is read."""
    kind = str(values.get("camera_model") or "").upper()
    if str(values.get("is_fisheye", "")).lower() not in ("", "0", "false", "none"):
        kind = "OPENCV_FISHEYE" if kind in ("", "OPENCV", "OPENCV_FISHEYE") else f"{kind} that is a fisheye"
    kind = "FULL_OPENCV" if (full := kind in _PERSPECTIVE) else kind
    if kind not in pycolmap.CameraModelId.__members__ or kind == "INVALID":
        raise ValueError(f"camera_model {kind} is none of COLMAP's")
    width, height = float(values["w"]), float(values["h"])
    if not all(1 <= side <= _MAX_SIDE_PX for side in (width, height)):
        raise ValueError(f"a camera of {width:g} x {height:g} px")
    focal = {key: float(values[key]) for key in ("fl_x", "fl_y") if key in values}
    angles = {}
    for axis, side in (("x", width), ("y", height)):
        if (key := f"camera_angle_{axis}") in values and kind == "FULL_OPENCV":
            if not 0 < float(values[key]) < math.pi:
                raise ValueError(f"{key} is {values[key]}; it lies between 0 and pi")
            angles[f"fl_{axis}"] = 0.5 * side / math.tan(0.5 * float(values[key]))
    for key in focal.keys() & angles.keys():
        if abs(focal[key] / angles[key] - 1) > _SAME_FOCAL:
            raise ValueError(f"{key} is {focal[key]:g}, but camera_angle_{key[-1]} says {angles[key]:g}")
    lengths = focal or angles
    focal_x, focal_y = lengths["fl_x"], lengths.get("fl_y", lengths["fl_x"])
    camera = pycolmap.Camera.create_from_model_name(1, kind, focal_x, int(width), int(height))
    names = camera.params_info.replace(" ", "").split(",")
    if "f" in names and focal_x != focal_y:
        raise ValueError(f"fl_y is not fl_x, but camera_model {kind} has one focal length")
    if full:
        names = names[:9]  # what other programs call k4 is no denominator, as OpenCV's is
    given = {"fx": focal_x, "fy": focal_y, "f": focal_x, "k": values.get("k1", 0.0)}
    given |= {"cx": values.get("cx", width / 2), "cy": values.get("cy", height / 2)}
    params = [
        float(given[n] if n in given else values.get(n, 0.0) if n[0] in "kps" else values[n]) for n in names
    ]
    camera.params = np.pad(params, (0, len(camera.params) - len(params)))
    read = _FOCAL | set(names) | ({"k1"} if "k" in names else set())
    for key, value in values.items():
        if key not in read and not _HARMLESS.fullmatch(key) and value is not None and any(np.ravel(value)):
            raise ValueError(
                f"{key} is {str(value)[:40]}, which camera_model {kind} does not have; remove it if it changes no projection"
            )
    return camera
