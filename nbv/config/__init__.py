"""What one mission is made of: frozen, typed, validated settings with units in their names.

``declaration`` says what a field declares and how it is read and checked, the files ``sections_`` hold the fields,
``mission_config`` the whole and its digest, ``presets`` the named configurations that a user starts from, ``conditions`` the
named environments in which missions run, ``names`` the parts of the program that a configuration may name.
"""

from nbv.config.conditions import (
    IDEAL_CONDITION,
    Condition,
    condition_from_dict,
    load_condition,
    load_conditions,
    require_distinct,
    shipped_files,
    under,
)
from nbv.config.declaration import Declaration
from nbv.config.mission_config import (
    IDEAL,
    MissionConfig,
    config_from_dict,
    parameter,
    parameters,
)
from nbv.config.names import DENSE_BACKENDS, GATES, RENDERERS, SCORERS, gate_kinds
from nbv.config.presets import PRESETS, preset
from nbv.config.sections_planning import (
    BAwareConfig,
    PoolConfig,
    SeedConfig,
    Weights,
)
from nbv.config.sections_reconstruction import DenseConfig, EvaluationConfig, SparseConfig
from nbv.config.sections_world import (
    TELEMETRY_LEVELS,
    CameraConfig,
    FlightConfig,
    SceneConfig,
    SensorConfig,
    TelemetryConfig,
    WindConfig,
)

__all__ = [
    "DENSE_BACKENDS",
    "GATES",
    "IDEAL",
    "IDEAL_CONDITION",
    "PRESETS",
    "RENDERERS",
    "SCORERS",
    "TELEMETRY_LEVELS",
    "BAwareConfig",
    "CameraConfig",
    "Condition",
    "Declaration",
    "DenseConfig",
    "EvaluationConfig",
    "FlightConfig",
    "MissionConfig",
    "PoolConfig",
    "SceneConfig",
    "SeedConfig",
    "SensorConfig",
    "SparseConfig",
    "TelemetryConfig",
    "Weights",
    "WindConfig",
    "condition_from_dict",
    "config_from_dict",
    "gate_kinds",
    "load_condition",
    "load_conditions",
    "parameter",
    "parameters",
    "preset",
    "require_distinct",
    "shipped_files",
    "under",
]
