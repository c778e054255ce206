"""What the studies of adaptive plans share: generated rocks whose size is roughly known, and adaptive plans on them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from nbv.config import MissionConfig, preset
from nbv.geometric.geometric_fidelity import GeometricFidelity
from nbv.mission.fidelity import MissionContext
from nbv.mission.result import MissionResult
from nbv.photogrammetric.photogrammetric_fidelity import PhotogrammetricFidelity
from nbv.rocks.families import FAMILIES, HELD_OUT_FROM, VALIDATION_FROM
from nbv.types import Capture, Cloud, SparseModel, UpdateReport
from research.other_shapes import SHAPES, load_shape

FIRST_SEED = {"train": 0, "validation": VALIDATION_FROM, "held-out": HELD_OUT_FROM}
FIDELITIES: dict[str, Any] = {"geometric": GeometricFidelity, "photogrammetric": PhotogrammetricFidelity}
Listener = Callable[[Any, SparseModel, MissionConfig], None]  # the last is what the vehicle plans by
BASE: dict[str, Any] = {
    "dense.agreeing_views": 3,
    "sparse.ground_features": 2000,
    "sparse.min_registered_seeds": 6,
    "seed.layout": "turn",
    "seed.radius_m": 3.5,
    "seed.lowest_deg": 10.0,
    "stop.criterion": "budget",
    **{f"predicted.weights.{term}": 0.0 for term in ("nov", "move", "ang")},
}


def rocks_of(split: str, per_family: int, first: int = 0, families: Iterable[str] = FAMILIES) -> list[str]:
    """The first so many rocks of every family in a split, family by family within a seed."""
    start = FIRST_SEED[split] + first
    return [f"{family}-{seed}" for seed in range(start, start + per_family) for family in families]


def base(**values: Any) -> MissionConfig:
    """The base configuration with some values changed."""
    return preset("campaign").with_values({**BASE, **values})


@dataclass(frozen=True)
class AdaptiveMission:
    """A mission and the sparse model that it ended with; None where it had none."""

    result: MissionResult
    model: SparseModel | None
    vehicle_config: MissionConfig  # what it planned by, the target as it was found


class _Kept:
    """Implements ``nbv.types.Reconstructor``: another one, whose last model is kept, and about what it was to be."""

    def __init__(self, inner: Any, listen: Listener, vehicle_config: MissionConfig) -> None:
        self._inner, self._listen = inner, listen
        self.model: SparseModel | None = None
        self.vehicle_config = vehicle_config

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def bootstrap(self, captures: Sequence[Capture]) -> UpdateReport:
        return self._keep(self._inner.bootstrap(captures))

    def add(self, capture: Capture) -> UpdateReport:
        self.planned_m = capture.viewpoint.position_m
        return self._keep(self._inner.add(capture))

    def recentre(self, target_m: tuple[float, float, float], crop_half_width_m: float) -> None:
        self.vehicle_config = self.vehicle_config.with_values(
            {"target_m": target_m, "dense.crop_half_width_m": crop_half_width_m}
        )
        self._inner.recentre(target_m, crop_half_width_m)

    def finish(self) -> Cloud:
        cloud: Cloud = self._inner.finish()
        return cloud

    def _keep(self, report: UpdateReport) -> UpdateReport:
        self.model = report.model
        self._listen(self, report.model, self.vehicle_config)
        return report


def run_missions(
    config: MissionConfig,
    rock: str,
    fidelity: str = "geometric",
    replicate: int = 0,
    listen: Listener = lambda reconstructor, model, vehicle_config: None,
) -> AdaptiveMission:
    """One mission in this process, of which nothing is written, on a rock or one of `research.other_shapes.SHAPES`.

    ``listen`` is called with the reconstructor, its model and `vehicle_config`, after the seeds and after every further photograph.
    """
    kept: list[Any] = []

    class Listening(FIDELITIES[fidelity]):  # type: ignore[misc]
        load = staticmethod(load_shape if rock in SHAPES else FIDELITIES[fidelity].load)

        def __init__(self, context: MissionContext) -> None:
            super().__init__(context)
            self.reconstructor = _Kept(self.reconstructor, listen, self.vehicle_config)
            kept[:] = [self.reconstructor]

    result = Listening.run(config, rock, replicate)
    return AdaptiveMission(result, kept[0].model, kept[0].vehicle_config)
