"""Undistortion against the lens that distorted, and masks by their names."""

from pathlib import Path

import numpy as np
import pycolmap
import pytest
from PIL import Image

from nbv.errors import UserError
from nbv.photographs.folder import SourcePhotograph
from nbv.photographs.import_source import ImportSource, find_masks
from nbv.photographs.importer import common_pinhole, undistorted


def lens(k: float, width: int = 320, height: int = 240, focal: float = 260.0) -> pycolmap.Camera:
    return pycolmap.Camera(
        model="SIMPLE_RADIAL", width=width, height=height, params=[focal, width / 2, height / 2, k]
    )


@pytest.mark.parametrize("k", [-0.1, 0.0, 0.1])
def test_the_pinhole_is_filled_and_no_longer_than_it_must_be(k: float) -> None:
    camera = lens(k)
    small = lens(0.05, 160, 120)
    pinhole = common_pinhole([small, camera, small, lens(0.3), small, camera])
    white = np.full((240, 320, 3), 255, np.uint8)
    assert undistorted(white, camera, pinhole).min() > 250
    wider = type(pinhole)(pinhole.width_px, pinhole.height_px, 0.97 * pinhole.focal_px)
    assert undistorted(white, camera, wider).min() == 0
    if k == 0:
        assert pinhole.focal_px == pytest.approx(260.0, rel=0.005)


def test_masks_are_found_by_name(tmp_path: Path) -> None:
    photographs = [
        SourcePhotograph(Path(f"IMG_{i}.JPG"), f"IMG_{i}", "", (64, 48), 1, "", None, None, None)
        for i in range(4)
    ]
    white = np.full((24, 32), 255, np.uint8)
    for name in ("img_0.png", "IMG_1_mask.png", "IMG_2.JPG.png"):
        Image.fromarray(white).save(tmp_path / name)
    found = find_masks(tmp_path, photographs)
    assert set(found) == {"IMG_0", "IMG_1", "IMG_2"}
    source = ImportSource(tuple(photographs), 64, lambda *_: None, masks=found)
    assert source.mask("IMG_3") is None
    (tmp_path / "img_0.png").write_bytes(b"no picture")
    with pytest.raises(UserError, match="cannot be read"):
        source.mask("IMG_0")
