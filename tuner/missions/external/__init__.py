"""Own missions: a file says what a mission takes, a request goes in, a result comes out."""

from tuner.missions.external.mission_file import (
    ExternalConfig,
    MissionFile,
    configuration_from_dict,
    external_config,
    load_mission_file,
)

__all__ = [
    "ExternalConfig",
    "MissionFile",
    "configuration_from_dict",
    "external_config",
    "load_mission_file",
]
