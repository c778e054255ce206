"""What distinguishes one kind of mission from another; everything else they share (`nbv.mission.flying`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from nbv.cache import Store
from nbv.config import MissionConfig
from nbv.gates import Oracle
from nbv.mission.run_directory import RunDirectory
from nbv.rocks import Rock
from nbv.stopwatch import Stopwatch
from nbv.types import Camera, Cloud, Reconstructor
from nbv.viewpoints import ViewpointSource


@dataclass(frozen=True)
class MissionContext:
    """What a fidelity is made from."""

    config: MissionConfig
    rock: Rock
    replicate: int
    believed: MissionConfig  # what the vehicle takes for ``config``: its target may lie elsewhere
    store: Store | None  # None: nothing is kept between missions
    keeps_everything: bool  # whether `Fidelity.export` will be called
    stopwatch: Stopwatch  # for stages of the fidelity's own


class Fidelity(Protocol):
    """How one mission sees the world, and how its outcome is measured."""

    @property
    def name(self) -> str:
        """As results state it."""

    @property
    def believed(self) -> MissionConfig:
        """What the vehicle plans, flies and reconstructs by."""

    @property
    def viewpoints(self) -> ViewpointSource:
        """Where photographs may be taken."""

    @property
    def camera(self) -> Camera:
        """What takes the photographs."""

    @property
    def reconstructor(self) -> Reconstructor:
        """What they become."""

    @property
    def facts(self) -> Mapping[str, Any]:
        """For the provenance: backends, versions."""

    def oracle(self) -> Oracle:
        """What the oracle gates, and nothing else that plans, may ask."""

    def measure(self, cloud: Cloud) -> dict[str, Any]:
        """The metrics of the mission's cloud; `MissionFailure` where it has none."""

    def export(self, run: RunDirectory, metrics: dict[str, Any]) -> None:
        """Write what a whole run directory holds of this fidelity; ``metrics`` are empty when the mission failed."""
