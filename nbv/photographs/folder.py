"""The user's folder: which of its files are photographs, what EXIF says of each, and masks beside them."""

from __future__ import annotations

import hashlib
import io
import math
import os
import re
import unicodedata
import warnings
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from PIL.ExifTags import IFD, Base

from nbv.errors import UserError
from nbv.safe_files import expanded, read_bytes, require
from nbv.types import Bools

PLAIN = (".jpg", ".jpeg", ".png")
OTHERS = (".tif", ".tiff", ".heic", ".heif", ".hif")
FORMATS = ("JPEG", "PNG")  # whatever the suffix; of several pictures in a JPEG file the first counts
FEWEST, MOST = 8, 2000
MAX_FILE_BYTES = 512 * 2**20
MAX_PIXELS = 200_000_000
DARKEST = 64  # of 255: the brightest pixel is below it where bits are shifted, such as 12 in 16
_DATE_TEXT = re.compile(r"(\d{4}):(\d\d):(\d\d) (\d\d:\d\d:\d\d)")
# What says that another lens, zoom or part of the sensor took a photograph.
_LENS_TAGS = [tag for tag in Base if re.match("Lens|BodySerial|Focal|DigitalZoom", tag.name)]
# What cameras write into a text that they do not know, without spaces and punctuation.
_UNKNOWN = re.compile(
    r"0*(mm)?f?0*|1|unknown.*|undefined|unspecified|none|null|na|notavailable|nolens.*|default"
)
_CONVERT = "convert such files: mogrify -format jpg -quality 97 *.heic *.tif"
_FRAMES = "of a video take frames first: ffmpeg -i VIDEO -vf fps=2 frames/%04d.jpg"
Turn = Image.Transpose
# By EXIF's orientation, how stored pixels come upright.
_TURNS = {
    2: Turn.FLIP_LEFT_RIGHT,
    3: Turn.ROTATE_180,
    4: Turn.FLIP_TOP_BOTTOM,
    5: Turn.TRANSPOSE,
    6: Turn.ROTATE_270,
    7: Turn.TRANSVERSE,
    8: Turn.ROTATE_90,
}
_INVERSE = {turn: turn for turn in Turn} | {Turn.ROTATE_90: Turn.ROTATE_270, Turn.ROTATE_270: Turn.ROTATE_90}
MIRRORED = (2, 4, 5, 7)  # of EXIF's orientations: the stored pixels are a mirror image
Progress = Callable[[str, int, int], None]  # what is done, how many of them, of how many


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
        return (height, width) if self.orientation in (5, 6, 7, 8) else (width, height)

    def turns(self, *, upright: bool, turned: bool = False) -> tuple[Turn, ...]:
        """What makes of stored pixels, or of such as are ``turned`` as EXIF says, a picture ``upright`` or as the sensor saw it.

        A mirror image is never worked on: COLMAP would find the mirror image of the object.
        """
        turn = _TURNS.get(self.orientation)
        if turn is None or (upright and turned):
            return ()
        if upright:
            return (turn,)
        mirrored = (Turn.FLIP_LEFT_RIGHT,) if self.orientation in MIRRORED else ()
        return ((_INVERSE[turn],) if turned else ()) + mirrored


def read_folder(
    folder: str | Path, progress: Progress, masks: Path | None = None
) -> tuple[list[SourcePhotograph], list[str]]:
    """The photographs in a folder and its subfolders, in the order in which they were taken, and notes on what was left out.

    `UserError` where there is no such folder, nothing or far too much in it, HEIC or TIFF, or a damaged file.
    """
    folder = expanded(folder)
    paths, notes = _photograph_files(folder, masks and expanded(masks).resolve())
    photographs: list[SourcePhotograph] = []
    damaged: list[str] = []
    for index, path in enumerate(paths):
        progress("reading photographs", index, len(paths))
        try:
            photographs.append(_read(path))
        except UserError as error:
            damaged.append(f"{_readable(path.name)} ({error})")
    if damaged:
        raise UserError(
            f"{len(damaged)} of {len(paths)} photographs in {folder} cannot be read: {', '.join(damaged[:3])}"
            f"{', ...' if len(damaged) > 3 else ''}; repair them, or move them out of the folder"
        )
    unique = {photograph.sha256: photograph for photograph in reversed(photographs)}
    if len(unique) < len(photographs):
        notes.append(f"left out {len(photographs) - len(unique)} files that are copies of others")
    if len(unique) < FEWEST:
        raise UserError(f"{folder} has {len(unique)} photographs; a set needs {FEWEST} or more that overlap")
    photographs = sorted(unique.values(), key=lambda p: (p.time or "", p.path))
    return _with_names(photographs, folder), notes


def read_pixels(path: Path, max_size_px: int, turns: Sequence[Turn] = ()) -> NDArray[np.uint8]:
    """(H, W, 3) RGB, shrunk to ``max_size_px`` on the long side; the stored pixels are transposed by ``turns`` in turn.

    `UserError` where the file is missing, damaged or too large.
    """
    with _opened(path) as (picture, _):
        width, height = picture.size
        if picture.format in ("JPEG", "MPO"):
            picture.draft("RGB", (min(width, 2 * max_size_px), min(height, 2 * max_size_px)))
        size_px = shrunk_size((width, height), max_size_px)
        return np.asarray(transposed(_eight_bit(picture).resize(size_px, Image.Resampling.LANCZOS), turns))


def transposed(picture: Image.Image, turns: Sequence[Turn]) -> Image.Image:
    for turn in turns:
        picture = picture.transpose(turn)
    return picture


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
        folders[:] = sorted(f for f in folders if f[0] != "." and f not in of_masks)
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
def _opened(path: Path) -> Iterator[tuple[Image.Image, bytes]]:
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


def _eight_bit(picture: Image.Image, mode: str = "RGB") -> Image.Image:
    if picture.mode in ("F", "I"):
        raise UserError("its numbers have 32 bits, and nothing says what is white; save it with 8 or 16")
    if picture.mode.startswith("I;16"):
        picture = Image.fromarray((np.asarray(picture) >> 8).astype(np.uint8))
    return picture.convert(mode)


def _read(path: Path) -> SourcePhotograph:
    with _opened(path) as (picture, data):
        width, height = picture.size
        exif = picture.getexif()
        details: Mapping[int, Any] = {**exif, **exif.get_ifd(IFD.Exif)}  # TIFF/EP has no block of EXIF's
        orientation = exif.get(Base.Orientation, 1)
        device = " ".join(str(exif.get(tag, "")).strip("\0 ") for tag in (Base.Make, Base.Model)).strip()
        date = _DATE_TEXT.match(str(details.get(Base.DateTimeOriginal) or exif.get(Base.DateTime) or ""))
        picture.draft("RGB", (width // 8, height // 8))  # reads all of the file, decodes little of it
        peak = int(np.asarray(_eight_bit(picture)).max())
        if peak < DARKEST:
            raise UserError(f"no pixel is brighter than {peak} of 255, as with 12 bits in 16; brighten it")
        if picture.has_transparency_data and np.asarray(picture.convert("RGBA"))[..., 3].min() < 255:
            raise UserError(
                "it has transparent parts: mogrify -alpha off, and --masks with what was transparent"
            )
    lens = (f"{tag.name} {told}" for tag in _LENS_TAGS if (told := _told(details.get(tag))))
    return SourcePhotograph(
        path=path,
        name=path.stem,
        sha256=hashlib.sha256(data).hexdigest(),
        size_px=(width, height),
        orientation=orientation if orientation in _TURNS else 1,
        device=", ".join(filter(None, (device, *lens))),
        focal_35_mm=_number(_told(details.get(Base.FocalLengthIn35mmFilm))),
        time="{}-{}-{}T{}".format(*date.groups()) if date else None,
        gps=_position(exif.get_ifd(IFD.GPSInfo)),
    )


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


def _with_names(photographs: list[SourcePhotograph], folder: Path) -> list[SourcePhotograph]:
    """With unique names: two files may differ in their suffix alone, in "/" that was "_", or in bytes that are no UTF-8."""
    parts = [p.path.relative_to(folder) for p in photographs]
    names = [_readable("_".join(part.with_suffix("").parts)) for part in parts]
    if len({name.lower() for name in names}) < len(names):
        names = [f"{index}_{name}" for index, name in enumerate(names)]
    return [replace(p, name=name) for p, name in zip(photographs, names, strict=True)]


def _readable(name: str) -> str:
    """A file's name as text that can be printed and written: bytes that are no UTF-8 become "?"."""
    return os.fsencode(name).decode(errors="replace").replace("\ufffd", "?")


def files_of_photographs(
    files: Iterable[str],
    photographs: Sequence[SourcePhotograph],
    what: str,
) -> dict[str, str]:
    """Which of ``files`` is of which photograph, by the photograph's name: it has that name, with suffix or without, in any case.

    Folders belong together whose paths have most names in common, counted from the end. `UserError` where two files of ``what``
    fit one photograph equally well, or one file fits two.
    """
    file_parts = {file: _parts(file) for file in files}
    photograph_parts = {p.name: _parts(str(p.path.absolute())) for p in photographs}
    common = {
        (a, b): len(list(takewhile(lambda pair: pair[0] == pair[1], zip(a[::-1], b[::-1]))))
        for a in {path[:-1] for path in file_parts.values()}
        for b in {path[:-1] for path in photograph_parts.values()}
    }
    most: dict[tuple[int, tuple[str, ...]], int] = defaultdict(int)
    for pair, count in common.items():
        for side in enumerate(pair):
            most[side] = max(most[side], count)
    by_key: dict[str, list[str]] = defaultdict(list)
    for file, path in file_parts.items():
        for key in {path[-1], path[-1].rpartition(".")[0]} if path else ():
            by_key[key].append(file)
    file_of: dict[str, str] = {}
    for whole in (True, False):
        new: dict[str, str] = {}
        for name, (*folder, base) in photograph_parts.items():
            key = base if whole else base.rpartition(".")[0]
            free = [f for f in by_key[key] if name not in file_of and f not in file_of.values()]
            pairs = ((file, (file_parts[file][:-1], tuple(folder))) for file in free)
            fit = [f for f, pair in pairs if all(common[pair] == most[side] for side in enumerate(pair))]
            if len(fit) > 1 or (fit and fit[0] in new.values()):
                other = fit[1] if len(fit) > 1 else next(n for n, f in new.items() if f == fit[0])
                raise UserError(
                    f"{what} has one name in two folders, and nothing tells which is meant: {fit[0]} for {name}, or {other}; "
                    "give the photographs' folders the names that they have there"
                )
            if fit:
                new[name] = fit[0]
        file_of |= new
    return file_of


def _parts(path: str) -> tuple[str, ...]:
    """Folders and name, as file systems compare them that do not tell cases apart."""
    return PurePosixPath(unicodedata.normalize("NFC", path.replace("\\", "/")).casefold()).parts


def read_mask(path: Path) -> Bools:
    """(H, W) True on the object: what is white, 255 or 1, or, where not all is opaque, what is.

    `UserError` where the file is damaged, or holds values that are neither black nor white.
    """
    try:
        with _opened(path) as (picture, _):
            pixels = np.asarray(_eight_bit(picture, "RGBA"))
    except UserError as error:
        raise UserError(f"mask {path} cannot be read: {error}") from error
    values = pixels[..., :3].max(axis=2) if pixels[..., 3].min() == 255 else pixels[..., 3]
    if 1 < (top := int(values.max())) < 128:
        raise UserError(f"mask {path} is nowhere brighter than {top}; make it 0 and 255, or 0 and 1")
    return np.asarray(values > top / 2)


def find_masks(folder: str | Path, photographs: Sequence[SourcePhotograph]) -> dict[str, Path]:
    """Masks by the photographs' names: ``NAME.png``, ``NAME_mask.png`` or ``NAME.jpg.png``, in folders as the photographs.

    `UserError` where there is no such folder, no mask of any photograph in it, or nothing tells whether one is turned.
    """
    folder = expanded(folder)
    if not folder.is_dir():
        raise UserError(f"there is no folder of masks {folder}; check --masks")
    taken = {p.path.resolve() for p in photographs}
    paths = [p for p in sorted(folder.rglob("*")) if p.suffix.lower() == ".png" and p.resolve() not in taken]
    # Without "_mask", unless there is such a file, too.
    files = {re.sub("_mask.png$", ".png", str(p.relative_to(folder)), flags=re.I): p for p in reversed(paths)}
    file_of = files_of_photographs(files, photographs, str(folder))
    if not file_of:
        raise UserError(
            f"no mask in {folder} is of a photograph; call them like the photographs: {photographs[0].path.stem}.png"
        )
    for photograph in photographs:
        same_sides = photograph.upright_size_px == photograph.size_px
        if photograph.name in file_of and photograph.orientation != 1 and same_sides:
            raise UserError(
                f"{photograph.path.name} is turned by EXIF (orientation {photograph.orientation}), and nothing tells whether "
                "its mask is; turn photographs and masks upright: mogrify -auto-orient"
            )
    return {name: files[file] for name, file in file_of.items()}
