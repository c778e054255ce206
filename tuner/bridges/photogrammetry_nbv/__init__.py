"""The authors' configuration files (``scoring.yaml``, ``unified_mission.yaml``) with the values of ours.

Facts about their keys come from the public repository ``photogrammetry_nbv`` at commit b8e106c; nothing of its code is here.
"""

from tuner.bridges.photogrammetry_nbv.files import read_file, write_text
from tuner.bridges.photogrammetry_nbv.keys import FILES, MISSION, SCORING, Remark
from tuner.bridges.photogrammetry_nbv.writing import NoSuchGate, carried, write_mission, write_scoring

__all__ = [
    "FILES",
    "MISSION",
    "SCORING",
    "NoSuchGate",
    "Remark",
    "carried",
    "read_file",
    "write_mission",
    "write_scoring",
    "write_text",
]
