"""What an import works on, from the user's files to the set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from nbv.cache import Store
from nbv.errors import UserError
from nbv.photographs.folder import Progress, SourcePhotograph, read_mask, read_pixels, shrunk_size, transposed
from nbv.types import Bools

SAME_RATIO = 0.02  # of sides, relative


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
        return read_pixels(photograph.path, self.max_size_px, photograph.turns(upright=self.upright))

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
        turns = photograph.turns(upright=self.upright, turned=alike[0])
        picture = transposed(Image.fromarray(inside), turns).resize(
            self.size_px(name), Image.Resampling.NEAREST
        )
        return np.asarray(picture)

    def up(self, name: str) -> tuple[float, float]:
        """Direction (right, down) in the picture that points up for a viewer."""
        orientation = 1 if self.upright else self.by_name[name].orientation
        right = {5: 1.0, 6: -1.0, 7: -1.0, 8: 1.0}.get(orientation, 0.0)
        return right, 0.0 if right else 1.0 if orientation in (3, 4) else -1.0

    def turned(self) -> ImportSource:
        """The same turned as EXIF says, unless the stored pixels have fewer different sizes.

        A telephone held both ways is one camera with pixels as stored, and two once they are turned.
        """
        upright, stored = ({getattr(p, k) for p in self.photographs} for k in ("upright_size_px", "size_px"))
        return replace(self, upright=len(upright) <= len(stored))
