"""The user's folder: which of its files are photographs, what EXIF and XMP say of each, and masks beside them."""

from __future__ import annotations

import hashlib
import importlib
import io
import math
import os
import re
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps
from PIL.ExifTags import IFD, Base

from nbv.errors import UserError
from nbv.safe_files import expanded, read_bytes, require
from nbv.types import Bools

PLAIN = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
HEIC = (".heic", ".heif", ".hif")
VIDEOS = (".mp4", ".mov", ".avi", ".mkv", ".m4v", ".mts", ".webm")
FORMATS = ("JPEG", "PNG", "TIFF")  # JPEG: also several pictures in one file, of which the first counts
FEWEST, MOST = 8, 2000
MAX_FILE_BYTES = 512 * 2**20
MAX_MASK_BYTES = 64 * 2**20
MAX_PIXELS = 200_000_000
_GIMBAL = re.compile(rb"Gimbal(Yaw|Pitch|Roll)Degree\s*(?:=\s*\"|>)\s*([-+]?\d+(?:\.\d+)?)")
_DATE_TEXT = re.compile(r"(\d{4}):(\d\d):(\d\d) (\d\d:\d\d:\d\d)")
Progress = Callable[[str, int, int], None]  # what is done, how many of them, of how many


@dataclass(frozen=True)
class SourcePhotograph:
    """A file of the user's and what it says of itself."""

    path: Path
    name: str  # without suffix, unique in the folder
    sha256: str
    size_px: tuple[int, int]  # width and height as stored
    orientation: int  # EXIF's: 1 upright, 3 upside down, 6 and 8 turned
    device: str  # make and model; "" where unknown
    focal_35_mm: float | None  # focal length of a camera with 36 x 24 mm film and the same view
    time: str | None
    gps: tuple[float, float, float | None] | None  # None: no altitude
    gimbal_deg: tuple[float, float, float] | None

    @property
    def upright_size_px(self) -> tuple[int, int]:
        """Width and height when turned as EXIF says."""
        width, height = self.size_px
        return (height, width) if self.orientation in (5, 6, 7, 8) else (width, height)


def read_folder(folder: str | Path, progress: Progress) -> tuple[list[SourcePhotograph], list[str]]:
    """The photographs of a folder in the order in which they were taken, and notes on what was left out.

    Every file is decoded once, so that a truncated one is found before anything else is done.

    Raises
    ------
    UserError
        There is no such folder, nothing or far too much in it, a video, HEIC without its library, or damaged files.
    """
    folder = expanded(folder)
    paths, notes = _photograph_files(folder)
    found: list[SourcePhotograph] = []
    damaged: list[str] = []
    for index, path in enumerate(paths):
        progress("reading photographs", index, len(paths))
        try:
            found.append(_read(path))
        except UserError as error:
            damaged.append(f"{path.name} ({error})")
    if damaged:
        raise UserError(
            f"{len(damaged)} of {len(paths)} photographs in {folder} cannot be read: {', '.join(damaged[:3])}"
            f"{', ...' if len(damaged) > 3 else ''}; copy them again, or move them out of the folder"
        )
    unique = {photograph.sha256: photograph for photograph in reversed(found)}
    if len(unique) < len(found):
        notes.append(f"left out {len(found) - len(unique)} files that are copies of others")
    if len(unique) < FEWEST:
        raise UserError(f"{folder} has {len(unique)} photographs; a set needs {FEWEST} or more that overlap")
    photographs = sorted(unique.values(), key=lambda p: (p.time or "", p.path.name))
    return _with_names(photographs), notes


def read_pixels(path: Path, max_size_px: int, *, upright: bool) -> NDArray[np.uint8]:
    """(H, W, 3) RGB, shrunk to ``max_size_px`` on the long side; ``upright``: turned as EXIF says.

    Raises
    ------
    UserError
        The file is missing, damaged or too large.
    """
    with _opened(path) as (picture, _):
        width, height = picture.size
        if picture.format in ("JPEG", "MPO"):
            picture.draft("RGB", (min(width, 2 * max_size_px), min(height, 2 * max_size_px)))
        turned = ImageOps.exif_transpose(picture) if upright else picture
        if (width > height) != (turned.width > turned.height):
            width, height = height, width
        size_px = shrunk_size((width, height), max_size_px)
        return np.asarray(_eight_bit(turned).resize(size_px, Image.Resampling.LANCZOS))


def shrunk_size(size_px: tuple[int, int], max_size_px: int) -> tuple[int, int]:
    """Width and height of a picture whose long side is at most ``max_size_px``."""
    scale = min(1.0, max_size_px / max(size_px))
    return max(1, round(size_px[0] * scale)), max(1, round(size_px[1] * scale))


def _photograph_files(folder: Path) -> tuple[list[Path], list[str]]:
    if folder.suffix.lower() in VIDEOS and folder.is_file():
        raise UserError(_video(folder))
    if not folder.is_dir():
        raise UserError(f"there is no folder {folder}; name the folder that holds the photographs")
    try:
        with os.scandir(folder) as entries:
            names = sorted(e.name for e in entries if not e.name.startswith(".") and e.is_file())
    except OSError as error:
        raise UserError(f"cannot read {folder}: {error.strerror}") from error
    files = [folder / name for name in names]
    paths = [p for p in files if p.suffix.lower() in PLAIN + HEIC]
    videos = [p for p in files if p.suffix.lower() in VIDEOS]
    if not paths:
        if videos:
            raise UserError(_video(videos[0]))
        raise UserError(
            f"there are no photographs in {folder} (JPEG, PNG, TIFF or HEIC; folders in it are not looked into)"
        )
    require(len(paths), MOST, f"the number of photographs in {folder}")
    if any(p.suffix.lower() in HEIC for p in paths):
        _load_heic()
    notes = []
    if others := Counter(p.suffix.lower() or "no suffix" for p in files if p not in set(paths)):
        notes.append(f"left out {sum(others.values())} files of other kinds ({', '.join(sorted(others))})")
    return paths, notes


def _video(path: Path) -> str:
    return (
        f"{path.name} is a video; take frames out of it first, for example: "
        f"ffmpeg -i {path.name} -vf fps=2 frames/%04d.jpg"
    )


def _load_heic() -> None:
    try:
        importlib.import_module("pillow_heif").register_heif_opener()
    except ImportError as error:
        raise UserError("HEIC needs another library; install it: pip install pillow-heif") from error


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Image.Image, bytes]]:
    data = read_bytes(path, MAX_FILE_BYTES)
    if not data:
        raise UserError("empty")
    if path.suffix.lower() in HEIC:
        _load_heic()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of size, which is looked at here, and of odd EXIF
            with Image.open(
                io.BytesIO(data), formats=None if path.suffix.lower() in HEIC else FORMATS
            ) as picture:
                require(picture.width * picture.height, MAX_PIXELS, f"the number of pixels of {path.name}")
                yield picture, data
    except UserError:
        raise
    except Exception as error:  # Pillow's decoders raise families of their own on damaged bytes
        raise UserError((str(error).strip().splitlines() or [type(error).__name__])[0][:80]) from error


def _eight_bit(picture: Image.Image) -> Image.Image:
    if picture.mode.startswith("I"):
        deep = np.asarray(picture).astype(np.float64)
        return Image.fromarray((deep / max(deep.max(), 1.0) * 255).astype(np.uint8)).convert("RGB")
    return picture.convert("RGB")


def _read(path: Path) -> SourcePhotograph:
    with _opened(path) as (picture, data):
        size = picture.size
        exif = picture.getexif()
        details: Mapping[int, Any] = exif.get_ifd(IFD.Exif)
        gps: Mapping[int, Any] = exif.get_ifd(IFD.GPSInfo)
        xmp = picture.info.get("xmp", b"")
        picture.draft("RGB", (size[0] // 8, size[1] // 8))  # reads all of the file, decodes little of it
        picture.load()
    orientation = exif.get(Base.Orientation, 1)
    device = " ".join(str(exif.get(tag, "")).strip("\0 ") for tag in (Base.Make, Base.Model)).strip()
    date = _DATE_TEXT.match(str(details.get(Base.DateTimeOriginal) or exif.get(Base.DateTime) or ""))
    return SourcePhotograph(
        path=path,
        name=path.stem,
        sha256=hashlib.sha256(data).hexdigest(),
        size_px=size,
        orientation=orientation if orientation in range(1, 9) else 1,
        device=device,
        focal_35_mm=_number(details.get(Base.FocalLengthIn35mmFilm)),
        time="{}-{}-{}T{}".format(*date.groups()) if date else None,
        gps=_position(gps),
        gimbal_deg=_gimbal(xmp if isinstance(xmp, bytes) else str(xmp).encode()),
    )


def _number(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) and number > 0 else None


def _position(gps: Mapping[int, Any]) -> tuple[float, float, float | None] | None:
    """Latitude and longitude in degrees and altitude in metres from EXIF's GPS block; an altitude of 0 is none."""
    try:
        degrees = [
            sum(float(part) / 60**power for power, part in enumerate(gps[tag]))
            * (-1 if gps.get(tag - 1) in ("S", "W") else 1)
            for tag in (2, 4)
        ]
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        return None
    altitude = _number(gps.get(6))
    if altitude is not None and gps.get(5) in (
        1,
        3,
        b"\x01",
        b"\x03",
    ):  # below sea level, below the ellipsoid
        altitude = -altitude
    return (degrees[0], degrees[1], altitude) if all(map(math.isfinite, degrees)) and any(degrees) else None


def _gimbal(xmp: bytes) -> tuple[float, float, float] | None:
    found = {axis: float(text) for axis, text in _GIMBAL.findall(xmp)}
    yaw, pitch, roll = (found.get(axis) for axis in (b"Yaw", b"Pitch", b"Roll"))
    return None if yaw is None or pitch is None or roll is None else (yaw, pitch, roll)


def _with_names(photographs: list[SourcePhotograph]) -> list[SourcePhotograph]:
    """With unique names: two files may differ in their suffix alone."""
    counts = Counter(p.path.stem for p in photographs)
    return [p if counts[p.name] == 1 else replace(p, name=p.path.name.replace(".", "_")) for p in photographs]


@dataclass(frozen=True)
class Mask:
    """A file with a mask."""

    path: Path
    sha256: str

    def read(self, size_px: tuple[int, int]) -> Bools:
        """(H, W) True on the object, shrunk to the photograph's width and height.

        Raises
        ------
        UserError
            The file is damaged or its sides have another ratio.
        """
        try:
            pixels = read_pixels(self.path, max(size_px), upright=False)
        except UserError as error:
            raise UserError(f"mask {self.path} cannot be read: {error}") from error
        width, height = size_px
        if abs(pixels.shape[1] * height - pixels.shape[0] * width) > 0.02 * width * height:
            raise UserError(
                f"mask {self.path} is {pixels.shape[1]} x {pixels.shape[0]}, its photograph {width} x {height}; "
                "give masks with the photographs' ratio of sides"
            )
        rows = (np.arange(height) * pixels.shape[0]) // height
        columns = (np.arange(width) * pixels.shape[1]) // width
        return np.asarray(pixels[rows][:, columns].max(axis=2) > 127)


def find_masks(folder: str | Path, photographs: Sequence[SourcePhotograph]) -> dict[str, Mask]:
    """Masks by the photographs' names: ``NAME.png``, ``NAME_mask.png`` or ``NAME.jpg.png``.

    Raises
    ------
    UserError
        There is no such folder, or no mask of any photograph in it.
    """
    folder = expanded(folder)
    if not folder.is_dir():
        raise UserError(f"there is no folder of masks {folder}; check --masks")
    files = {p.name.lower(): p for p in sorted(folder.iterdir()) if p.suffix.lower() in PLAIN}
    found = {}
    for photograph in photographs:
        stem, whole = photograph.path.stem.lower(), photograph.path.name.lower()
        names = [
            f"{base}{end}{suffix}" for base in (stem, whole) for end in ("", "_mask") for suffix in PLAIN
        ]
        path = next((files[name] for name in names if name in files), None)
        if path is not None and path.resolve() != photograph.path.resolve():
            found[photograph.name] = Mask(path, hashlib.sha256(read_bytes(path, MAX_MASK_BYTES)).hexdigest())
    if not found:
        raise UserError(
            f"no mask in {folder} is of a photograph; call them like the photographs: {photographs[0].path.stem}.png"
        )
    return found
