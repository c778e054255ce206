"""Missions that are not ours: a file that says what they take, a request that goes in, a result that comes out."""

from tuner.missions.external.configuration import ExternalConfig, configuration_from_dict, external_config
from tuner.missions.external.contract import Request, read_result
from tuner.missions.external.mission_file import MissionFile, load_mission_file
from tuner.missions.external.slots import take_slot

__all__ = [
    "ExternalConfig",
    "MissionFile",
    "Request",
    "configuration_from_dict",
    "external_config",
    "load_mission_file",
    "read_result",
    "take_slot",
]
