"""The user's folder: which of its files are photographs, which are copies of others, and what EXIF says of each."""

from __future__ import annotations

import hashlib
import io
import math
import os
import re
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from PIL.ExifTags import IFD, Base

from nbv.errors import UserError
from nbv.safe_files import expanded, read_bytes, require
from nbv.types import Floats

PLAIN = (".jpg", ".jpeg", ".png")
OTHERS = (".tif", ".tiff", ".heic", ".heif", ".hif")
FORMATS = ("JPEG", "PNG")  # whatever the suffix; of several pictures in a JPEG file the first counts
FEWEST, MOST = 8, 5000
MAX_FILE_BYTES = 512 * 2**20
MAX_PIXELS = 200_000_000
DARKEST = 64  # of 255: the brightest pixel is below it where bits are shifted, such as 12 in 16, and in depth pictures
SAME_RATIO = 0.02  # of sides, relative
GRID = 16  # pictures are compared as so many grey values squared
# Rms difference of two grids in standard deviations of the grey of one. Copies of 270 photographs differ by at most 0.064 in
# another size (down to 64 px) and 0.034 saved at quality 30; the nearest two photographs of six sets by 0.21.
COPY_OF_ANOTHER_SIZE, COPY_OF_THE_SAME_SIZE = 0.1, 0.04
LEAST_CONTRAST = 4.0  # of 255, of a picture of one grey
_DEPTH = re.compile(r"depths?([_-]?maps?)?|confidence", re.IGNORECASE)  # folders of a telephone's scanner
_DATE_TEXT = re.compile(r"(\d{4}):(\d\d):(\d\d) (\d\d:\d\d:\d\d)")
# What says that another lens, zoom or part of the sensor took a photograph.
_LENS_TAGS = [tag for tag in Base if re.match("Lens|BodySerial|Focal|DigitalZoom", tag.name)]
# What cameras write into a text that they do not know, without spaces and punctuation.
_UNKNOWN = re.compile(
    r"0*(mm)?f?0*|1|unknown.*|undefined|unspecified|none|null|na|notavailable|nolens.*|default"
)
_CONVERT = "convert such files: mogrify -format jpg -quality 97 *.heic *.tif"
_FRAMES = "of a video take frames first: ffmpeg -i VIDEO -vf fps=2 frames/%04d.jpg"
_QUARTERS = {
    1: 0,
    3: 2,
    6: -1,
    8: 1,
}  # by EXIF's orientation, counter-clockwise, until stored pixels are upright
Progress = Callable[[str, int, int], None]  # what is done, how many of them, of how many


class _TooDark(UserError):
    """No pixel of a picture is bright."""


@dataclass(frozen=True)
class SourcePhotograph:
    """A file of the user's and what it says of itself."""

    path: Path
    name: str  # its path in the folder without suffix, "_" for "/"; unique
    sha256: str
    size_px: tuple[int, int]  # width and height as stored
    orientation: int  # EXIF's: 1 upright, 3 upside down, 6 and 8 turned
    device: str  # make, model, lens, zoom: whatever tells cameras apart; "" where unknown
    focal_35_mm: float | None  # focal length of a camera with 36 x 24 mm film and the same view
    time: str | None
    gps: tuple[float, float, float] | None  # latitude and longitude in degrees, altitude in metres

    @property
    def upright_size_px(self) -> tuple[int, int]:
        """Width and height when turned as EXIF says."""
        width, height = self.size_px
        return (height, width) if self.orientation in (6, 8) else (width, height)

    def quarters(self, *, upright: bool, turned: bool = False) -> int:
        """Counter-clockwise quarter turns from stored pixels, or ``turned`` ones, to a picture ``upright`` or as it is stored."""
        return _QUARTERS[self.orientation] * (upright - turned)


def read_folder(
    folder: str | Path, progress: Progress, masks: Path | None = None
) -> tuple[list[SourcePhotograph], list[str]]:
    """The photographs in a folder and its subfolders, in the order in which they were taken, and notes on what was left out.

    Of one picture in several sizes or compressions the largest is taken. `UserError` where there is no such folder, nothing or
    far too much in it, HEIC or TIFF, or a damaged file.
    """
    folder = expanded(folder)
    paths, notes = _photograph_files(folder, masks and expanded(masks).resolve())
    photographs: list[SourcePhotograph] = []
    grids: list[Floats] = []
    damaged: dict[Path, UserError] = {}
    for index, path in enumerate(paths):
        progress("reading photographs", index, len(paths))
        try:
            photograph, grid = _read(path)
        except UserError as error:
            damaged[path] = error
        else:
            photographs.append(photograph)
            grids.append(grid)
    if damaged:
        told = [f"{_readable(path.name)} ({error})" for path, error in damaged.items()]
        remedy = "repair them, or move them out of the folder"
        if all(isinstance(error, _TooDark) for error in damaged.values()):
            remedy = _other_folder(folder, {p.path.parent for p in photographs}) or "brighten them"
        raise UserError(
            f"{len(damaged)} of {len(paths)} photographs in {folder} cannot be read: {', '.join(told[:3])}"
            f"{', ...' if len(damaged) > 3 else ''}; {remedy}"
        )
    kept, left_out = _without_copies(photographs, np.array(grids))
    if left_out:
        copy, of = ((p.path.relative_to(folder)) for p in left_out[0])
        notes.append(
            f"left out {len(left_out)} of {len(photographs)} pictures, which are others in another size or compression "
            f"(as {_readable(str(copy))} of {_readable(str(of))})"
        )
    if len(kept) < FEWEST:
        raise UserError(f"{folder} has {len(kept)} photographs; a set needs {FEWEST} or more that overlap")
    kept.sort(key=lambda p: (p.time or "", p.path))
    parts = [p.path.relative_to(folder) for p in kept]
    names = [_readable("_".join(part.with_suffix("").parts)) for part in parts]
    if len({name.lower() for name in names}) < len(names):
        # Two files may differ in their suffix alone, in "/" that was "_", or in bytes that are no UTF-8.
        names = [f"{index}_{name}" for index, name in enumerate(names)]
    return [replace(p, name=name) for p, name in zip(kept, names, strict=True)], notes


def _other_folder(folder: Path, bright: set[Path]) -> str:
    """Where the photographs are of which ``folder`` has depth pictures, or nothing."""
    if not bright:
        beside = (p for p in folder.resolve().parent.iterdir() if p.is_dir() and p != folder.resolve())
        bright = {
            p
            for p in beside
            if not _DEPTH.fullmatch(p.name) and any(f.suffix.lower() in PLAIN for f in p.iterdir())
        }
    named = " or ".join(sorted(_readable(str(p)) for p in bright))
    return f"if these are depth pictures, give the folder of the photographs: {named}" if named else ""


def _without_copies(
    photographs: list[SourcePhotograph], grids: Floats
) -> tuple[list[SourcePhotograph], list[tuple[SourcePhotograph, SourcePhotograph]]]:
    """The photographs without smaller or more compressed copies, and each copy with what it is one of.

    ``grids`` (N, `GRID`^2) grey. Of equally large ones that which says most of itself is kept, then the largest file. Pictures
    that were taken at different times are no copies.
    """
    contrast = np.maximum(grids.std(axis=1), LEAST_CONTRAST)

    def worth(index: int) -> tuple[int, int, int, int, str]:
        p = photographs[index]
        told = sum(map(bool, (p.time, p.device, p.gps)))
        return -math.prod(p.size_px), -told, -p.path.stat().st_size, len(str(p.path)), str(p.path)

    kept: list[int] = []
    copies = []
    for index in sorted(range(len(photographs)), key=worth):
        one = photographs[index]
        away = np.sqrt(((grids[kept] - grids[index]) ** 2).mean(axis=1)) / np.minimum(
            contrast[kept], contrast[index]
        )
        for row in np.flatnonzero(away < COPY_OF_ANOTHER_SIZE).tolist():
            other = photographs[kept[row]]
            (width, height), (x, y) = one.upright_size_px, other.upright_size_px
            same_size = (width, height) == (x, y)
            if (
                away[row] < (COPY_OF_THE_SAME_SIZE if same_size else COPY_OF_ANOTHER_SIZE)
                and abs(width * y / (height * x) - 1) < SAME_RATIO
                and len({one.time, other.time} - {None}) < 2
            ):
                copies.append((one, other))
                break
        else:
            kept.append(index)
    return [photographs[i] for i in sorted(kept)], copies


def read_pixels(path: Path, max_size_px: int, quarters: int = 0) -> NDArray[np.uint8]:
    """(H, W, 3) RGB, shrunk to ``max_size_px`` on the long side, turned counter-clockwise by ``quarters`` of a turn.

    `UserError` where the file is missing, damaged or too large.
    """
    with opened(path) as (picture, _):
        width, height = picture.size
        if picture.format in ("JPEG", "MPO"):
            picture.draft("RGB", (min(width, 2 * max_size_px), min(height, 2 * max_size_px)))
        size_px = shrunk_size((width, height), max_size_px)
        pixels = np.asarray(eight_bit(picture).resize(size_px, Image.Resampling.LANCZOS))
    return np.ascontiguousarray(np.rot90(pixels, quarters))


def shrunk_size(size_px: tuple[int, int], max_size_px: int) -> tuple[int, int]:
    """Width and height of a picture whose long side is at most ``max_size_px``."""
    scale = min(1.0, max_size_px / max(size_px))
    return max(1, round(size_px[0] * scale)), max(1, round(size_px[1] * scale))


def _photograph_files(folder: Path, masks: Path | None) -> tuple[list[Path], list[str]]:
    if not folder.is_dir():
        raise UserError(f"there is no folder {folder}; name the one that holds the photographs; {_FRAMES}")
    files: list[Path] = []
    notes: list[str] = []

    def unreadable(error: OSError) -> None:
        raise UserError(f"cannot read {error.filename}: {error.strerror}") from error

    for root, folders, names in os.walk(folder, onerror=unreadable):
        of_masks = [f for f in folders if f.lower() in ("mask", "masks") or Path(root, f).resolve() == masks]
        notes += [f"left out the masks in {f}" for f in of_masks if Path(root, f).resolve() != masks]
        of_depths = [f for f in folders if _DEPTH.fullmatch(f)]
        notes += [f"left out the depth pictures in {f}" for f in of_depths]
        folders[:] = sorted(f for f in folders if f[0] != "." and f not in of_masks + of_depths)
        linked = [_readable(f) for f in folders if Path(root, f).is_symlink()]
        notes += [f"left out the linked folder {f}; to have its photographs, copy it there" for f in linked]
        files += [Path(root, name) for name in sorted(names) if name[0] != "." and Path(root, name).is_file()]
    lower = {str(p).lower() for p in files}
    paths = [p for p in files if p.suffix.lower() in PLAIN and not _is_mask(p, lower)]
    if other := next((p for p in files if p.suffix.lower() in OTHERS), None):
        raise UserError(f"{other} is neither JPEG nor PNG; {_CONVERT}, or move them out of the folder")
    if not paths:
        raise UserError(
            f"there are no photographs in {folder} or the folders in it; give JPEG or PNG files; {_FRAMES}"
        )
    require(len(paths), MOST, f"the number of photographs in {folder}")
    if others := Counter(p.suffix.lower() or "no suffix" for p in files if p not in set(paths)):
        notes.append(
            f"left out {sum(others.values())} masks and files of other kinds ({', '.join(sorted(others))})"
        )
    return paths, notes


def _is_mask(path: Path, lower: set[str]) -> bool:
    """Whether a photograph lies beside it that has its name but for ``_mask`` or a second suffix."""
    base = str(path.with_suffix("")).lower()
    return base in lower or (base.endswith("_mask") and any(base[:-5] + s in lower for s in PLAIN))


@contextmanager
def opened(path: Path) -> Iterator[tuple[Image.Image, bytes]]:
    data = read_bytes(path, MAX_FILE_BYTES)
    if not data:
        raise UserError("empty")
    if data[4:8] == b"ftyp":  # a telephone may call it .jpg
        raise UserError(f"it is HEIC; {_CONVERT}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of size, which is looked at here, and of odd EXIF
            with Image.open(io.BytesIO(data), formats=FORMATS) as picture:
                require(picture.width * picture.height, MAX_PIXELS, f"the number of pixels of {path.name}")
                yield picture, data
    except UserError:
        raise
    except UnidentifiedImageError as error:
        kind = "TIFF" if data[:4] in (b"II*\0", b"MM\0*") else "neither JPEG nor PNG"
        raise UserError(f"it is {kind}, whatever its name says; {_CONVERT}") from error
    except Exception as error:  # Pillow's decoders raise families of their own on damaged bytes
        raise UserError((str(error).strip().splitlines() or [type(error).__name__])[0][:80]) from error


def eight_bit(picture: Image.Image, mode: str = "RGB") -> Image.Image:
    if picture.mode in ("F", "I"):
        raise UserError("its numbers have 32 bits, and nothing says what is white; save it with 8 or 16")
    if picture.mode.startswith("I;16"):
        picture = Image.fromarray((np.asarray(picture) >> 8).astype(np.uint8))
    return picture.convert(mode)


def _read(path: Path) -> tuple[SourcePhotograph, Floats]:
    """A photograph and its upright grid of grey, (`GRID`^2,)."""
    with opened(path) as (picture, data):
        width, height = picture.size
        exif = picture.getexif()
        details: Mapping[int, Any] = {**exif, **exif.get_ifd(IFD.Exif)}  # TIFF/EP has no block of EXIF's
        orientation = exif.get(Base.Orientation, 1)
        if orientation in (2, 4, 5, 7):
            raise UserError(
                f"EXIF says that it is a mirror image (orientation {orientation}): mogrify -auto-orient"
            )
        device = " ".join(str(exif.get(tag, "")).strip("\0 ") for tag in (Base.Make, Base.Model)).strip()
        date = _DATE_TEXT.match(str(details.get(Base.DateTimeOriginal) or exif.get(Base.DateTime) or ""))
        picture.draft("RGB", (8 * GRID, 8 * GRID))  # reads all of the file, decodes little of it
        whole = eight_bit(picture)
        peak = int(np.asarray(whole).max())
        if peak < DARKEST:
            raise _TooDark(f"no pixel is brighter than {peak} of 255, as with 12 bits in 16 or depths")
        grid = np.asarray(whole.convert("L").resize((GRID, GRID), Image.Resampling.LANCZOS), dtype=float)
        if picture.has_transparency_data and np.asarray(picture.convert("RGBA"))[..., 3].min() < 255:
            raise UserError(
                "it has transparent parts: mogrify -alpha off, and --masks with what was transparent"
            )
    lens = (f"{tag.name} {told}" for tag in _LENS_TAGS if (told := _told(details.get(tag))))
    photograph = SourcePhotograph(
        path=path,
        name=path.stem,
        sha256=hashlib.sha256(data).hexdigest(),
        size_px=(width, height),
        orientation=orientation if orientation in _QUARTERS else 1,
        device=", ".join(filter(None, (device, *lens))),
        focal_35_mm=_number(_told(details.get(Base.FocalLengthIn35mmFilm))),
        time="{}-{}-{}T{}".format(*date.groups()) if date else None,
        gps=_position(exif.get_ifd(IFD.GPSInfo)),
    )
    return photograph, np.rot90(grid, photograph.quarters(upright=True)).ravel()


def _told(value: Any) -> str:
    """A tag's value as text; "" where it means nothing: absent, 0, 1, all bits set, not a number, "Unknown", "N/A", "----"."""
    if isinstance(value, tuple):
        return " ".join(filter(None, map(_told, value)))
    if isinstance(value, str | bytes):
        text = value.decode("latin-1") if isinstance(value, bytes) else value
        text = " ".join(text.replace("\0", " ").split())
        return "" if _UNKNOWN.fullmatch(re.sub(r"[\W_]", "", text).lower()) else text
    number = _number(value)
    return "" if number in (None, 1.0, 65535.0) else f"{number:.6g}"


def _number(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) and number > 0 else None


def _position(gps: Mapping[int, Any]) -> tuple[float, float, float] | None:
    """Latitude, longitude and altitude from EXIF's GPS block; None where one is missing, and an altitude of 0 is."""
    try:
        latitude, longitude = (sum(float(part) / 60**k for k, part in enumerate(gps[tag])) for tag in (2, 4))
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        return None
    north, east = (-1 if str(gps.get(tag)).strip("\0 ").upper()[:1] in ("S", "W") else 1 for tag in (1, 3))
    up = -1 if gps.get(5) in (1, 3, b"\x01", b"\x03") else 1  # below sea level, below the ellipsoid
    altitude = _number(gps.get(6))
    if altitude is None or not math.isfinite(latitude + longitude):
        return None
    return north * latitude, east * longitude, up * altitude


def _readable(name: str) -> str:
    """A file's name as text that can be printed and written: bytes that are no UTF-8 become "?"."""
    return os.fsencode(name).decode(errors="replace").replace("\ufffd", "?")
