"""The authors' configuration files (``scoring.yaml``, ``unified_mission.yaml``) read into ours and written back.

Facts about their keys come from the public repository ``photogrammetry_nbv`` at commit b8e106c; nothing of its code is here.
"""

from tuner.bridges.photogrammetry_nbv.carrying import carried
from tuner.bridges.photogrammetry_nbv.configuring import FUNCTION, configuration, files_beside
from tuner.bridges.photogrammetry_nbv.files import read_file, write_mission_folder, write_text
from tuner.bridges.photogrammetry_nbv.keys import FILES, MISSION, SCORING
from tuner.bridges.photogrammetry_nbv.reading import read_mission, read_scoring
from tuner.bridges.photogrammetry_nbv.remarks import Remark
from tuner.bridges.photogrammetry_nbv.writing import write_mission, write_scoring

__all__ = [
    "FILES",
    "FUNCTION",
    "MISSION",
    "SCORING",
    "Remark",
    "carried",
    "configuration",
    "files_beside",
    "read_file",
    "read_mission",
    "read_scoring",
    "write_mission",
    "write_mission_folder",
    "write_scoring",
    "write_text",
]
