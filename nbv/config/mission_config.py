"""What one mission is made of: frozen, typed, validated, with units in the names.

The defaults are preset ``paper``; every field says where its default comes from (`nbv.config.declaration`).
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from dataclasses import dataclass, field
from typing import Any

from nbv.config.declaration import (
    Declaration,
    Section,
    ThreeOrMore,
    code,
    declared,
    leaves,
    nearest,
    not_in_paper,
    replaced,
    text,
)
from nbv.config.names import DENSE_BACKENDS, GATES, RENDERERS, SCORERS
from nbv.config.sections_planning import (
    BAwareConfig,
    CovisConfig,
    GateConfig,
    PoolConfig,
    PredictedConfig,
    SeedConfig,
    SharedTermsConfig,
    StopConfig,
)
from nbv.config.sections_reconstruction import DenseConfig, EvaluationConfig, SparseConfig
from nbv.config.sections_world import (
    CameraConfig,
    FlightConfig,
    SceneConfig,
    SensorConfig,
    TargetConfig,
    TelemetryConfig,
    WindConfig,
    telemetry_level,
)
from nbv.errors import UserError
from nbv.plugins import Plugin, settings_class

WIDEST_STEP_DEG = 25.0  # 22.5 registers, 30 does not
IDEAL = "ideal"  # the condition of a configuration that no condition was laid over
PLUGINS = "plugins"  # the field with the sections of plug-ins


@dataclass(frozen=True)
class MissionConfig(Section):
    """Everything that decides a mission's outcome, together with the rock and the replicate."""

    preset: str = not_in_paper("paper", "name of the preset that it began as")
    condition: str = not_in_paper(IDEAL, "name of the condition that it is under")
    target_m: tuple[float, float, float] = code((0.0, 0.0, 0.8), "mission file", "target, above the ground")
    photographs: ThreeOrMore = code(
        64, "mission file, 24 + 40", "photographs of a mission, registered or not: seeds, and planned views"
    )
    seeds: ThreeOrMore = text(
        24, "III", "photographs taken before any view is planned; as many as photographs: none is planned"
    )
    camera: CameraConfig = field(default_factory=CameraConfig)
    scene: SceneConfig = field(default_factory=SceneConfig)
    sensor: SensorConfig = field(default_factory=SensorConfig)
    wind: WindConfig = field(default_factory=WindConfig)
    flight: FlightConfig = field(default_factory=FlightConfig)
    seed: SeedConfig = field(default_factory=SeedConfig)
    pool: PoolConfig = field(default_factory=PoolConfig)
    stop: StopConfig = field(default_factory=StopConfig)
    shared: SharedTermsConfig = field(default_factory=SharedTermsConfig)
    covis: CovisConfig = field(default_factory=CovisConfig)
    b_aware: BAwareConfig = field(default_factory=BAwareConfig)
    predicted: PredictedConfig = field(default_factory=PredictedConfig)
    gate: GateConfig = field(default_factory=GateConfig)
    telemetry: TelemetryConfig = field(default_factory=TelemetryConfig)
    target: TargetConfig = field(default_factory=TargetConfig)
    sparse: SparseConfig = field(default_factory=SparseConfig)
    dense: DenseConfig = field(default_factory=DenseConfig)
    evaluation: EvaluationConfig = field(default_factory=EvaluationConfig)
    # Settings of plug-ins that are not their defaults, by name: ``config.mine.alpha``.
    plugins: tuple[tuple[str, Any], ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        for plugin in self.plugins_used:
            _ = plugin.loaded  # one that cannot be is said now
        if self.wind.strongest_m_s >= self.flight.max_speed_m_s:
            raise UserError(
                f"wind.mean_speed_m_s {self.wind.mean_speed_m_s:g} with three gusts of {self.wind.gust_m_s:g} is more "
                f"than the vehicle can hold (flight.max_speed_m_s {self.flight.max_speed_m_s:g})"
            )
        self._require_seeds_that_register()

    def _require_seeds_that_register(self) -> None:
        """Seeds that are more than the photographs, or cannot become a model, are refused before a flight."""
        seeds, least = self.seeds, self.sparse.min_registered_seeds
        if seeds > self.photographs:
            raise UserError(
                f"seeds is {seeds}, more than the {self.photographs} photographs of a mission; take fewer seeds, or more "
                "photographs"
            )
        if seeds < least:
            raise UserError(
                f"seeds is {seeds}, below sparse.min_registered_seeds {least}: no such mission can go on; lower the latter "
                "or take more seeds"
            )
        step_deg = 360.0 / (seeds if self.seed.layout == "rings" else max(n for _, n in self.seed_rings))
        if not self.sparse.ground_features and step_deg > WIDEST_STEP_DEG:
            raise UserError(
                f"seeds is {seeds}, which puts them {step_deg:.0f} degrees apart, and SIFT alone does not hold views "
                f"more than {WIDEST_STEP_DEG:g} apart together; set sparse.ground_features (2000), or seeds to "
                f"{int(-(-360 // WIDEST_STEP_DEG))} or more"
            )

    def require_flyable(self) -> None:
        """`UserError` where seeds or target meet the ground, or home is in the keep-out; asked of what is ordered, not of an estimate."""
        home, flight = self.flight.home_m, self.flight
        away_m = math.hypot(home[0] - self.target_m[0], home[1] - self.target_m[1])
        if away_m < flight.keep_out_radius_m and home[2] < flight.keep_out_height_m:
            raise UserError(
                f"flight.home_m is {away_m:.2f} m from the target's axis, inside the keep-out of "
                f"{flight.keep_out_radius_m:g} m (flight.keep_out_radius_m); take off farther away"
            )
        if self.target.ground_m and self.target_m[2] <= self.target.ground_m:
            raise UserError(
                f"target.ground_m {self.target.ground_m:g} is not below the target's centre, at {self.target_m[2]:g} m; lower it"
            )
        lowest_deg = min(elevation_deg for elevation_deg, _ in self.seed_rings)
        lowest_m = self.target_m[2] + self.seed.radius_m * math.sin(math.radians(lowest_deg))
        least_m = self.flight.min_camera_altitude_m
        if lowest_m < least_m:
            raise UserError(
                f"the lowest ring of seeds meets the ground: it lies at {lowest_m:.2f} m, and the camera flies no lower "
                f"than {least_m:g} m (flight.min_camera_altitude_m); raise its elevation"
            )

    def __getattr__(self, name: str) -> Any:
        """The settings that a plug-in declares: ``config.mine`` is the section ``mine``."""
        if not name.startswith("_") and name != PLUGINS:
            for section, values in self.plugins:
                if section == name:
                    return values
            if (settings := settings_class(name)) is not None:
                return settings()
        raise AttributeError(f"a mission's configuration has no {name!r}")

    @property
    def plugins_used(self) -> list[Plugin]:
        """The plug-ins that this mission plans, renders and reconstructs with."""
        named = (
            (SCORERS, self.gate.kind),
            (GATES, self.gate.kind),
            (SCORERS, self.gate.geometry_scorer),
            (RENDERERS, self.scene.backend),
            (DENSE_BACKENDS, self.dense.backend),
        )
        return [plugin for names, name in named if (plugin := names.plugin(name)) is not None]

    @property
    def fills_rings(self) -> bool:
        """Whether views between the seeds are candidates: where *predicted* may choose between them and others."""
        return "predicted" in (self.gate.kind, self.gate.geometry_scorer)

    @property
    def plans_on_depth(self) -> bool:
        """Whether depth is asked for in flight: by a scorer that may rank views, or to say how complete the cloud will be."""
        return self.fills_rings or self.stop.criterion == "predicted"

    @property
    def planned_views(self) -> int:
        """Photographs after the seeds, at most: a stopping criterion may hold earlier."""
        return self.photographs - self.seeds

    @property
    def seed_rings(self) -> tuple[tuple[float, int], ...]:
        """Elevation (degrees) and number of views of each ring of seeds, in the order flown."""
        return self.seed.rings(self.seeds)

    def to_dict(self) -> dict[str, Any]:
        """Plain nested dictionary (tuples become lists), ready for JSON or YAML."""
        tree = _by_field(self)
        of_plugins = dict(tree.pop(PLUGINS))
        # A campaign asks thousands of times; `dataclasses.asdict`, which copies all values, takes twice as long.
        plain: dict[str, Any] = json.loads(json.dumps({**tree, **of_plugins}, default=_by_field))
        return plain

    def changed(self, **values: Any) -> MissionConfig:
        """A copy with fields of its own replaced, and those of sections: ``changed(target_m=..., dense={"neighbours": 4})``."""
        new = {
            name: dataclasses.replace(getattr(self, name), **value) if isinstance(value, dict) else value
            for name, value in values.items()
        }
        return dataclasses.replace(self, **new)

    def digest(self) -> str:
        """First 16 hex digits of the SHA-256 of the JSON form, and of the plug-ins that the mission uses."""
        plugins = [[plugin.name, plugin.facts] for plugin in self.plugins_used]
        form = json.dumps([self.to_dict(), plugins], sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(form.encode()).hexdigest()[:16]

    def with_values(self, values: dict[str, Any]) -> MissionConfig:
        """A copy with the named parameter paths replaced, e.g. ``{"covis.weights.nov": 0.3}``.

        ``{"telemetry": "rtk"}`` sets all fields of that section to a level of `TELEMETRY_LEVELS`.

        `UserError` where a path or level does not exist, or a value has the wrong type or range.
        """
        if not values:
            return self
        config = config_from_dict(values, self)
        config.require_flyable()
        return config


def _by_field(section: Any) -> dict[str, Any]:
    return {each.name: getattr(section, each.name) for each in dataclasses.fields(section)}


def config_from_dict(tree: dict[str, Any], base: MissionConfig | None = None) -> MissionConfig:
    """Build a configuration from a nested dictionary or parameter paths; what is left out comes from ``base`` (default: ``paper``).

    `UserError` for an unknown key or telemetry level, wrong type, or a value out of range.
    """
    base, known = base or MissionConfig(), parameters()
    if isinstance(tree, dict):
        if isinstance(level := tree.get("telemetry"), str):
            tree = {**tree, "telemetry": dataclasses.asdict(telemetry_level(level))}
        known = known | {path: d for key in tree for path, d in _of_plugin(str(key)).items()}
    raw_values = leaves(known, tree, "mission parameter")
    values = {path: known[path].from_yaml(raw) for path, raw in raw_values.items()}
    sections = dict(base.plugins)
    of_plugins = [path for path in values if path not in parameters()]
    for section in {path.partition(".")[0] for path in of_plugins}:
        inner = f"{section}."
        changes = {p.removeprefix(inner): values.pop(p) for p in of_plugins if p.startswith(inner)}
        sections[section] = replaced(getattr(base, section), changes, inner)
    changed = sorted((name, part) for name, part in sections.items() if part != type(part)())
    return replaced(base, {**values, PLUGINS: tuple(changed)})


def parameters() -> dict[str, Declaration]:
    """What every parameter declares, by its path (``gate.d95_m``), in the order of declaration."""
    return declared(MissionConfig)


def parameter(path: str) -> Declaration:
    """What the parameter at ``path``, built in or a plug-in's, declares; `UserError`, which names the nearest, if there is none."""
    known = parameters() if path in parameters() else parameters() | _of_plugin(path)
    if path not in known:
        raise UserError(f"unknown mission parameter {path!r}; {nearest(path, known, 3)}")
    return known[path]


def _of_plugin(path: str) -> dict[str, Declaration]:
    """The parameters of the plug-in whose section ``path`` is in; empty where there is none."""
    section = path.partition(".")[0]
    if (
        section in {f.name for f in dataclasses.fields(MissionConfig)}
        or (settings := settings_class(section)) is None
    ):
        return {}
    return {
        f"{section}.{p}": dataclasses.replace(d, path=f"{section}.{p}") for p, d in declared(settings).items()
    }
