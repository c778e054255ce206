"""What distinguishes one kind of mission from another; everything else they share (`nbv.mission.flying`)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from nbv.cache import Store
from nbv.config import MissionConfig
from nbv.gates import GroundTruthOracle, Oracle
from nbv.mission.run_directory import RunDirectory
from nbv.rocks import Rock
from nbv.stopwatch import Stopwatch
from nbv.types import Camera, Cloud, Reconstructor
from nbv.viewpoints import RINGS, ViewpointSource


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


class Fidelity(ABC):
    """How one mission sees the world, and how its outcome is measured."""

    name: ClassVar[str]  # as results state it
    believed: MissionConfig  # what the vehicle plans, flies and reconstructs by
    viewpoints: ViewpointSource = RINGS  # where photographs may be taken
    camera: Camera  # what takes them
    reconstructor: Reconstructor  # what they become
    facts: Mapping[str, Any]  # for the provenance: backends, versions

    def __init__(self, context: MissionContext) -> None:
        self.context, self.believed = context, context.believed

    def oracle(self) -> Oracle:
        """What the oracle gates, and nothing else that plans, may ask: here the true surface."""
        rock = self.context.rock
        return GroundTruthOracle(rock.vertices_m, rock.faces, self.context.config)

    @abstractmethod
    def measure(self, cloud: Cloud) -> dict[str, Any]:
        """The metrics of the mission's cloud; `MissionFailure` where it has none."""

    @abstractmethod
    def export(self, run: RunDirectory, metrics: dict[str, Any]) -> None:
        """Write what a whole run directory holds of this fidelity; ``metrics`` are empty when the mission failed."""
