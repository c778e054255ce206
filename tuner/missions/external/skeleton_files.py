"""The working skeleton of ``gatetune mission init``: it packs real measurements with ``xz``."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
from matplotlib import cbook

from nbv.safe_files import write_new_folder


def write_skeleton(folder: Path) -> list[Path]:
    """Write mission file, mission and data into a new or empty folder; return what was written.

    The data are 16-bit measurements that come with Matplotlib: two halves of an elevation model (USGS, Jacksboro
    fault), and a magnetic resonance scan to hold out.

    Raises `UserError`: there is something in ``folder``, or it cannot be written.
    """
    source = Path(__file__).with_name("skeleton")
    text = (source / "mission.yaml").read_text("utf-8").replace("NAME", json.dumps(folder.resolve().name))
    function = (source / "mission.py").read_text("utf-8")
    return write_new_folder(folder, {"mission.yaml": text, "mission.py": function, **_measurements()})


def _measurements() -> dict[str, bytes]:
    samples = Path(cbook._get_data_path("sample_data"))
    with np.load(samples / "jacksboro_fault_dem.npz") as archive:
        heights = archive["elevation"].astype("<i2")
    half = len(heights) // 2
    return {
        "north.raw": heights[:half].tobytes(),
        "south.raw": heights[half:].tobytes(),
        "scan.raw": gzip.decompress((samples / "s1045.ima.gz").read_bytes()),
    }
