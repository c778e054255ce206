"""Missions that are not ours: a file that says what they take, a request that goes in, a result that comes out."""

from tuner.missions.external.configuration import ExternalConfig, configuration_from_dict, external_config
from tuner.missions.external.contract import Failure, Request, Result, read_result
from tuner.missions.external.mission_file import Instance, MissionFile, Resource, load_mission_file
from tuner.missions.external.process import Ended, run_command
from tuner.missions.external.slots import Slot, take_slot

__all__ = [
    "Ended",
    "ExternalConfig",
    "Failure",
    "Instance",
    "MissionFile",
    "Request",
    "Resource",
    "Result",
    "Slot",
    "configuration_from_dict",
    "external_config",
    "load_mission_file",
    "read_result",
    "run_command",
    "take_slot",
]
