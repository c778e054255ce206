"""Which of a configuration's changes a file of theirs carries."""

from __future__ import annotations

from collections.abc import Mapping

from nbv.config import MissionConfig
from tuner.bridges.photogrammetry_nbv.keys import FILES
from tuner.bridges.photogrammetry_nbv.writing import write_mission, write_scoring

WRITERS = dict(zip(FILES, (write_scoring, write_mission)))


def carried(kind: str, changes: Mapping[str, tuple[MissionConfig, MissionConfig]]) -> list[str]:
    """The changed parameters that a file of ``kind`` (a key of `FILES`) carries.

    Parameters
    ----------
    changes
        Per changed parameter path a configuration with the change, and the same without it.
    """
    found = []
    for path, (config, without) in changes.items():
        values, remarks = WRITERS[kind](config)
        before, remarks_before = WRITERS[kind](without)
        if path in {remark.key for remark in remarks if not remark.partly}:
            continue
        if values != before or path in {remark.key for remark in remarks_before}:
            found.append(path)
    return found
