"""What one mission is made of: frozen, typed, validated settings with units in their names.

``sections`` holds the fields and their ranges, ``mission_config`` the whole and its digest, ``parsing`` how
dictionaries and parameter paths become one, ``presets`` the named configurations that a user starts from.
"""

from nbv.config.mission_config import MissionConfig, canonical, config_from_dict, parameter_paths
from nbv.config.presets import ECONOMIES, PRESETS, preset
from nbv.config.sections import (
    GATE_KINDS,
    BAwareConfig,
    CameraConfig,
    CovisConfig,
    DenseConfig,
    EvaluationConfig,
    FlightConfig,
    GateConfig,
    GateKind,
    PoolConfig,
    SceneConfig,
    SeedConfig,
    SharedTermsConfig,
    SparseConfig,
    StopConfig,
    VisibilityConfig,
    Weights,
)

__all__ = [
    "ECONOMIES",
    "GATE_KINDS",
    "PRESETS",
    "BAwareConfig",
    "CameraConfig",
    "CovisConfig",
    "DenseConfig",
    "EvaluationConfig",
    "FlightConfig",
    "GateConfig",
    "GateKind",
    "MissionConfig",
    "PoolConfig",
    "SceneConfig",
    "SeedConfig",
    "SharedTermsConfig",
    "SparseConfig",
    "StopConfig",
    "VisibilityConfig",
    "Weights",
    "canonical",
    "config_from_dict",
    "parameter_paths",
    "preset",
]
