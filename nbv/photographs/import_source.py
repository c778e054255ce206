"""What an import works on: the photographs, which way up and at which size, masks of them, and files of their names."""

from __future__ import annotations

import re
import unicodedata
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from nbv.cache import Store
from nbv.errors import UserError
from nbv.photographs.folder import (
    SAME_RATIO,
    Progress,
    SourcePhotograph,
    eight_bit,
    opened,
    read_pixels,
    shrunk_size,
)
from nbv.safe_files import expanded
from nbv.types import Bools


@dataclass(frozen=True)
class ImportSource:
    """What an import works on: the photographs, in the order in which they were taken, at which size, which way up."""

    photographs: tuple[SourcePhotograph, ...]
    max_size_px: int  # of the long side
    progress: Progress
    store: Store | None = None  # keeps features, pairs, models and clouds, so that an import can go on
    upright: bool = True  # turned as EXIF says
    masks: Mapping[str, Path] = field(default_factory=dict)

    @cached_property
    def by_name(self) -> dict[str, SourcePhotograph]:
        return {p.name: p for p in self.photographs}

    def full_size_px(self, name: str) -> tuple[int, int]:
        """Width and height of the user's file."""
        photograph = self.by_name[name]
        return photograph.upright_size_px if self.upright else photograph.size_px

    def size_px(self, name: str) -> tuple[int, int]:
        """Width and height at which a photograph is worked on."""
        return shrunk_size(self.full_size_px(name), self.max_size_px)

    def pixels(self, name: str) -> NDArray[np.uint8]:
        """(H, W, 3) RGB; errors as `read_pixels`."""
        photograph = self.by_name[name]
        return read_pixels(photograph.path, self.max_size_px, photograph.quarters(upright=self.upright))

    def mask(self, name: str) -> Bools | None:
        """(H, W) True on the object; None where no mask was given. Its sides tell whether it was drawn on a photograph turned as EXIF says.

        `UserError` where they have another ratio, and as `read_mask`.
        """
        if name not in self.masks:
            return None
        photograph, inside = self.by_name[name], read_mask(self.masks[name])
        height, width = inside.shape
        sizes = (photograph.upright_size_px, photograph.size_px)
        alike = [abs(width / height * size[1] / size[0] - 1) < SAME_RATIO for size in sizes]
        if not any(alike):
            raise UserError(
                f"mask {self.masks[name]} is {width} x {height}, its photograph {sizes[0][0]} x {sizes[0][1]}; "
                "give masks with the photographs' ratio of sides"
            )
        turned = np.rot90(inside, photograph.quarters(upright=self.upright, turned=alike[0]))
        return np.asarray(Image.fromarray(turned).resize(self.size_px(name), Image.Resampling.NEAREST))

    def up(self, name: str) -> tuple[float, float]:
        """Direction (right, down) in the picture that points up for a viewer."""
        orientation = 1 if self.upright else self.by_name[name].orientation
        return {1: (0.0, -1.0), 3: (0.0, 1.0), 6: (-1.0, 0.0), 8: (1.0, 0.0)}[orientation]

    def turned(self) -> ImportSource:
        """The same turned as EXIF says, unless the stored pixels have fewer different sizes.

        A telephone held both ways is one camera with pixels as stored, and two once they are turned.
        """
        upright, stored = ({getattr(p, k) for p in self.photographs} for k in ("upright_size_px", "size_px"))
        return replace(self, upright=len(upright) <= len(stored))


def read_mask(path: Path) -> Bools:
    """(H, W) True on the object: what is white, 255 or 1, or, where not all is opaque, what is.

    `UserError` where the file is damaged, or holds values that are neither black nor white.
    """
    try:
        with opened(path) as (picture, _):
            pixels = np.asarray(eight_bit(picture, "RGBA"))
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


def files_of_photographs(
    files: Iterable[str], photographs: Sequence[SourcePhotograph], what: str
) -> dict[str, str]:
    """Which of ``files`` is of which photograph, by the photograph's name: it has that name, with suffix or without, in any case.

    Of several the one whose folders are most like the photograph's, counted from the end. `UserError` where two files of ``what``
    fit one photograph equally well, or one file fits two.
    """
    by_key: dict[str, list[str]] = defaultdict(list)
    for file in files:
        if base := (_parts(file) or ("",))[-1]:
            for key in {base, base.rpartition(".")[0]}:
                by_key[key].append(file)
    fits = []
    for photograph in photographs:
        *folders, base = _parts(str(photograph.path.absolute()))
        for key in (base, base.rpartition(".")[0]):
            fits += [
                ((key == base, _common(folders, _parts(f)[:-1])), photograph.name, f) for f in by_key[key]
            ]
    file_of: dict[str, str] = {}
    of_photograph: dict[str, tuple[bool, int]] = {}  # how well what it was given fits
    of_file: dict[str, tuple[bool, int]] = {}
    for fit, name, file in sorted(fits, key=lambda f: f[0], reverse=True):
        if name not in file_of and file not in of_file:
            file_of[name], of_photograph[name], of_file[file] = file, fit, fit
        elif file_of.get(name) != file and fit in (of_photograph.get(name), of_file.get(file)):
            other = file_of.get(name) or next(n for n, f in file_of.items() if f == file)
            raise UserError(
                f"{what} has one name in two folders, and nothing tells which is meant: {file} for {name}, or {other}; "
                "give the photographs' folders the names that they have there"
            )
    return file_of


def _common(folders: Sequence[str], others: Sequence[str]) -> int:
    """How many names from the end are the same."""
    same = [a == b for a, b in zip(reversed(folders), reversed(others), strict=False)]
    return [*same, False].index(False)


def _parts(path: str) -> tuple[str, ...]:
    """Folders and name, as file systems compare them that do not tell cases apart."""
    return PurePosixPath(unicodedata.normalize("NFC", path.replace("\\", "/")).casefold()).parts
