"""The user's masks: white where the object is, one picture a photograph."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nbv.errors import UserError
from nbv.photographs.folder import PLAIN, SourcePhotograph, read_pixels
from nbv.safe_files import expanded, read_bytes
from nbv.types import Bools

_MOST_BYTES = 64 * 2**20


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
            found[photograph.name] = Mask(path, hashlib.sha256(read_bytes(path, _MOST_BYTES)).hexdigest())
    if not found:
        raise UserError(
            f"no mask in {folder} is of a photograph; call them like the photographs: {photographs[0].path.stem}.png"
        )
    return found
