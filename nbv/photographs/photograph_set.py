"""An imported set of photographs on disk: ``set.json``, pictures, sparse model, dense reference and surface.

The set's frame is the program's world: z up, the object rests on z = 0, its footprint is centred on the origin, and the
median camera is 3.5 units from the object's centre. One unit is called a metre everywhere (``_m``), so that planner
geometry works unchanged; what it really measures is `PhotographSet.metres_per_unit`. Thresholds of a reconstruction are
stated as fractions of the object's height (`THRESHOLD_FRACTIONS`: 16 to 80 mm of 1.6 m).

Everything here is written once, by the import, and read with checks: nothing in a set's folder is code, and a damaged
file is a `UserError` of one line.
"""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from nbv.cache import home
from nbv.config import CameraConfig
from nbv.errors import UserError
from nbv.geometry.frames import azimuths_elevations_deg, camera_centers_m
from nbv.geometry.ply import read_ply, write_ply
from nbv.rocks.catalogue import check_name
from nbv.safe_files import RESULT_BYTES, parse_json, read_bytes, read_text, write_atomic
from nbv.types import Bools, Floats, PointCloud

FORMAT = 1
SET_FILE, IMAGES, MASKS = "set.json", "images", "masks"
SPARSE = "sparse"  # COLMAP's binary model in the set's frame; its images are called ``NAME.jpg``
REFERENCE_FILE, SURFACE_FILE = "reference.ply", "surface.npz"
THRESHOLD_FRACTIONS = (0.01, 0.02, 0.03, 0.04, 0.05)  # of the object's height
MEDIAN_DISTANCE_M = 3.5  # of the cameras from the object's centre
MAX_IMAGE_BYTES = 64 * 2**20
MAX_PHOTOGRAPHS = 5000
WIDE_GAP_DEG = 30.0  # between neighbours in azimuth: a step that SIFT rarely bridges
ScaleSource = Literal["length", "model", "gps", "none"]


@dataclass(frozen=True)
class Photograph:
    """One photograph of a set, undistorted."""

    name: str  # of images/NAME.jpg, where it registered; unique
    source: str  # the user's file
    sha256: str  # of the user's file
    camera_from_world: Floats | None  # (4, 4) in the set's frame; None: did not register
    masked: bool  # a mask was given

    def __post_init__(self) -> None:
        if self.name != Path(self.name).name or self.name.startswith("."):
            raise ValueError(f"{self.name!r} cannot name a photograph")

    @property
    def registered(self) -> bool:
        return self.camera_from_world is not None

    @property
    def camera_center_m(self) -> Floats:
        """(3,) where it was taken; only of a registered one."""
        if self.camera_from_world is None:
            raise ValueError(f"{self.name} is not registered")
        return camera_centers_m(self.camera_from_world)


@dataclass(frozen=True)
class Reference:
    """The dense cloud made of all registered photographs, in the set's frame."""

    points_m: Floats  # (N, 3)
    normals: Floats  # (N, 3) unit
    colors: NDArray[np.uint8]  # (N, 3) RGB
    error_m: Floats  # (N,) distance to the cloud of the worse half of the photographs

    def __len__(self) -> int:
        return len(self.points_m)

    def write(self, path: Path) -> None:
        """Write a binary PLY, which viewers open."""
        write_ply(path, PointCloud(self.points_m, self.colors, self.normals), error=self.error_m)

    @staticmethod
    def read(path: Path) -> Reference:
        """A reference as `write` writes it; `UserError` for any other file."""
        cloud, more = read_ply(path)
        if cloud.normals is None or cloud.colors is None or "error" not in more or not len(cloud.points_m):
            raise UserError(f"{path} is damaged; import the photographs again with --force")
        return Reference(cloud.points_m, cloud.normals, np.asarray(cloud.colors), more["error"])


@dataclass(frozen=True)
class PhotographPlaces:
    """From where photographs (M,) were taken, as seen from the object."""

    names: tuple[str, ...]
    azimuths_deg: Floats  # counter-clockwise, 0 to 360
    elevations_deg: Floats


def gaps_deg(azimuths_deg: Floats) -> list[tuple[float, float]]:
    """Azimuths between which none of ``azimuths_deg`` (N,) lies though they are far apart, widest first."""
    around = np.sort(azimuths_deg % 360)
    steps = np.diff(np.append(around, around[0] + 360))
    wide = [i for i in np.argsort(-steps) if steps[i] > WIDE_GAP_DEG]
    return [(float(around[i]), float((around[i] + steps[i]) % 360)) for i in wide]


_Positive = Annotated[float, msgspec.Meta(gt=0)]
_Photographs = Annotated[tuple[Photograph, ...], msgspec.Meta(min_length=1, max_length=MAX_PHOTOGRAPHS)]
_Curve = Annotated[
    tuple[float, ...],
    msgspec.Meta(min_length=len(THRESHOLD_FRACTIONS), max_length=len(THRESHOLD_FRACTIONS)),
]


@dataclass(frozen=True)
class HalvesAgreement:
    """One half of the photographs against the other: what a reconstruction can be told to have reached.

    Percentages at `THRESHOLD_FRACTIONS` of the height, mean over both directions; ``completeness`` is of the reference
    by a half's cloud, ``precision`` of a half's cloud by the other half's.
    """

    completeness: _Curve
    precision: _Curve
    f_score: _Curve


@dataclass(frozen=True)
class PhotographSet:
    """What ``gatetune photographs import`` made of a folder of photographs."""

    name: str
    folder: Path
    camera: CameraConfig  # one pinhole for all photographs, principal point in the middle
    photographs: _Photographs  # in the order in which they were taken
    height_m: _Positive  # of the object, in units of the set's frame
    extents_m: tuple[float, float, float]  # of the object's box, likewise
    metres_per_unit: _Positive | None  # None: no scale was given
    scale_source: ScaleSource
    reference_error_m: _Positive  # median distance of the reference's points to the worse half's cloud
    halves: HalvesAgreement
    weak: tuple[str, ...]  # where the reference is weak, a sentence each
    notes: tuple[str, ...]  # what was done
    source_folder: str

    @property
    def registered(self) -> tuple[Photograph, ...]:
        return tuple(p for p in self.photographs if p.registered)

    @property
    def coverage(self) -> PhotographPlaces:
        offsets = np.array([p.camera_center_m for p in self.registered]) - self.target_m
        azimuths, elevations = azimuths_elevations_deg(offsets)
        names = tuple(p.name for p in self.registered)
        return PhotographPlaces(names, azimuths, elevations)

    @property
    def target_m(self) -> tuple[float, float, float]:
        return (0.0, 0.0, self.height_m / 2)

    @property
    def true_height_m(self) -> float | None:
        """The object's height in metres, where there is a scale."""
        return None if self.metres_per_unit is None else self.height_m * self.metres_per_unit

    def image(self, name: str) -> NDArray[np.uint8]:
        """(H, W, 3) the undistorted photograph; `UserError` where the file is missing, damaged or of another size."""
        return read_image(self.folder, name, self.camera)

    def mask(self, name: str) -> Bools | None:
        """(H, W) True on the object, or None where no mask was given; errors as `image`."""
        return read_mask(self.folder, name, self.camera)

    def reference(self) -> Reference:
        """The dense reference; `UserError` where its file is damaged."""
        return Reference.read(self.folder / REFERENCE_FILE)

    @staticmethod
    def read(name: str) -> PhotographSet:
        """The set called ``name``; `UserError` where there is none, or its ``set.json`` is damaged."""
        folder = set_folder(name)
        if not (folder / SET_FILE).is_file():
            known = ", ".join(list_sets()) or "none yet"
            raise UserError(f"there is no set of photographs {name!r}; known: {known}")
        return read_set(folder)

    def write(self, folder: Path) -> None:
        """Write ``set.json`` into ``folder``; the other files are the import's to write."""
        tree = msgspec.to_builtins(self, enc_hook=lambda v: str(v) if isinstance(v, Path) else v.tolist())
        del tree["folder"]
        write_atomic(folder / SET_FILE, json.dumps({"format": FORMAT, **tree}, indent=1))


def sets_folder() -> Path:
    return home() / "photographs"


def set_folder(name: str) -> Path:
    """Where the set ``name`` is kept; `UserError` if that cannot be a name."""
    return sets_folder() / check_name(name)


def list_sets() -> list[str]:
    return sorted(p.parent.name for p in sets_folder().glob(f"[!.]*/{SET_FILE}") if p.is_file())


def read_set(folder: Path) -> PhotographSet:
    """The set in ``folder``; `UserError` where its ``set.json`` is damaged or of another format."""
    path = folder / SET_FILE
    tree = parse_json(read_text(path, RESULT_BYTES), str(path), finite=True)
    try:
        if tree["format"] != FORMAT:
            raise ValueError(f"format {tree['format']}, this version reads {FORMAT}")
        for name in ("width_px", "height_px", "focal_px"):  # a camera of the program has defaults
            tree["camera"][name]
        photographs = msgspec.convert({**tree, "folder": str(folder)}, PhotographSet, dec_hook=_decoded)
        check_name(photographs.name)
    except (UserError, KeyError, TypeError, ValueError) as error:
        reason = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else str(error)
        raise UserError(f"{path} is damaged ({reason}); import the photographs again with --force") from error
    return photographs


def _decoded(kind: type, value: Any) -> Any:
    if kind is Path:
        return Path(value)
    pose = np.array(value, dtype=float)
    if pose.shape != (4, 4):
        raise ValueError("a pose is not a rigid transform")
    return pose


def read_image(folder: Path, name: str, camera: CameraConfig) -> NDArray[np.uint8]:
    """(H, W, 3) an undistorted photograph in a set's folder; errors as `PhotographSet.image`."""
    return _pixels(folder / IMAGES / f"{name}.jpg", "RGB", camera)


def read_mask(folder: Path, name: str, camera: CameraConfig) -> Bools | None:
    """(H, W) a mask in a set's folder, if there is one; errors as `PhotographSet.image`."""
    path = folder / MASKS / f"{name}.png"
    return _pixels(path, "L", camera) > 127 if path.is_file() else None


def _pixels(path: Path, mode: str, camera: CameraConfig) -> NDArray[np.uint8]:
    data = read_bytes(path, MAX_IMAGE_BYTES)
    try:
        with Image.open(io.BytesIO(data), formats=("JPEG", "PNG")) as picture:
            if picture.size != (camera.width_px, camera.height_px):
                raise ValueError(f"it is {picture.size[0]} x {picture.size[1]}")
            return np.asarray(picture.convert(mode), dtype=np.uint8)
    except (OSError, ValueError, SyntaxError) as error:
        raise UserError(f"{path} is damaged ({error}); import the photographs again with --force") from error
