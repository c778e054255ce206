"""From a configuration to a result document: what distinguishes one kind of mission from another, and what all share."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import Any, ClassVar

from nbv.cache import Store
from nbv.config import IDEAL, MissionConfig, preset
from nbv.config.conditions import ENVIRONMENT_SECTIONS
from nbv.config.mission_config import parameters
from nbv.errors import MissionFailure, UserError
from nbv.flight import Flight
from nbv.gates import GroundTruthOracle, gate_class, make_gate
from nbv.mission.loop import AdaptiveMission
from nbv.mission.recorder import Recorder
from nbv.mission.result import Keep, Log, MissionResult, Status, no_log
from nbv.mission.run_directory import FLIGHT, LOCATED, PROGRESS, RESULT, RunDirectory
from nbv.mission.target_prior import with_size_error, with_target_error, with_true_target
from nbv.plugins import used
from nbv.process import Stopwatch
from nbv.provenance import provenance
from nbv.rocks import Rock, load_rock
from nbv.safe_files import write_atomic
from nbv.types import Camera, Cloud, Reconstructor
from nbv.viewpoints import RINGS, ViewpointSource

ENVIRONMENT = tuple(f"{section}." for section in ENVIRONMENT_SECTIONS)


@dataclass(frozen=True)
class MissionContext:
    config: MissionConfig  # with the true size of a generated rock: only metrics may use it, no planner
    rock: Rock
    replicate: int
    vehicle_config: MissionConfig  # ``config`` as the vehicle has it: its target may lie elsewhere
    store: Store | None  # None: nothing is kept between missions
    keeps_everything: bool  # whether `Fidelity.export` will be called
    stopwatch: Stopwatch  # for stages of the fidelity's own


@dataclass(frozen=True)
class Outcome:
    status: Status
    reason: str = ""
    message: str = ""
    metrics: dict[str, Any] = field(default_factory=dict)


class Fidelity(ABC):
    """How one mission sees the world, and how its outcome is measured."""

    name: ClassVar[str]  # as results state it
    vehicle_config: MissionConfig  # what the vehicle plans, flies and reconstructs by
    viewpoints: ViewpointSource = RINGS  # where photographs may be taken
    camera: Camera  # what takes them
    reconstructor: Reconstructor  # what they become
    # Parameters that it takes no notice of, as paths or sections with a dot behind: refused (`require_noticed`).
    unnoticed: ClassVar[Sequence[str]] = ()
    under_conditions: ClassVar[bool] = True  # whether a condition may set them even so
    follows_size: ClassVar[bool] = True  # whether target and crops follow a rock that is not 1.6 m high
    facts: Mapping[str, Any]  # for the provenance: backends, versions
    load: Callable[[str, Store | None], Rock] = staticmethod(load_rock)  # the rock of a name

    def __init__(self, context: MissionContext) -> None:
        self.context, self.vehicle_config = context, context.vehicle_config

    def oracle(self) -> GroundTruthOracle:
        """What the oracle gates, and nothing else that plans, may ask: here the true surface."""
        rock = self.context.rock
        return GroundTruthOracle(rock.vertices_m, rock.faces, self.context.config)

    @classmethod
    def require_noticed(cls, config: MissionConfig) -> None:
        """`UserError` where ``config`` sets what these missions take no notice of.

        A preset's own values may stand, and mostly a condition's: it is one environment for all fidelities.
        """
        usual, paths = preset(config.preset), list[str]()
        under_condition = config.condition != IDEAL
        for path in parameters():
            stands = cls.under_conditions and under_condition and path.startswith(ENVIRONMENT)
            if path.startswith(tuple(cls.unnoticed)) and not stands:
                read = attrgetter(path)
                paths += [path] if read(config) != read(usual) else []
        if paths:
            condition = f" (condition {config.condition})" if under_condition else ""
            raise UserError(
                f"{cls.name} missions take no notice of {', '.join(paths)}{condition}; leave them out, or choose another "
                "--fidelity or --rock"
            )

    @staticmethod
    def simulated(config: MissionConfig) -> MissionConfig:
        """``config`` without the errors of the vehicle's knowledge that this fidelity leaves out."""
        return config

    @abstractmethod
    def measure(self, cloud: Cloud) -> dict[str, Any]:
        """The metrics of the mission's cloud; `MissionFailure` where it has none."""

    def export(self, run: RunDirectory, metrics: dict[str, Any]) -> None:  # noqa: B027  some have nothing
        """Write what a whole run directory holds of this fidelity alone; ``metrics`` are empty when the mission failed."""

    @classmethod
    def run(
        cls,
        config: MissionConfig,
        rock: str,
        replicate: int = 0,
        directory: Path | None = None,
        *,
        keep: Keep = "all",
        overwrite: bool = False,
        cache: bool | Store = True,
        log: Log = no_log,
    ) -> MissionResult:
        """Run one mission and measure it: a `nbv.mission.result.MissionFunction`, which has the other parameters.

        ``overwrite``: a finished mission in ``directory`` may be replaced. ``cache``: what missions share is kept in the user's store, or in
        the one given; the outcome is the same without. ``log`` is given lines of text as the mission goes on.
        """
        started, stopwatch = time.perf_counter(), Stopwatch()
        store = cache if isinstance(cache, Store) else Store() if cache else None
        with stopwatch.timed("rock"):
            keeps_everything = directory is not None and keep == "all"
            context = cls.prepare(config, rock, replicate, store, keeps_everything, stopwatch)
        with stopwatch.timed("setup"):
            files = None if directory is None else RunDirectory(directory, overwrite=overwrite)
            if files is not None:
                files.write_config(context.config.to_dict())
            fidelity = cls(context)
            all_files = files if context.keeps_everything else None
            if all_files is not None and context.vehicle_config != context.config:
                all_files.write_config(context.vehicle_config.to_dict(), LOCATED)
            mission = fidelity.mission(all_files, files, log)
        outcome = fidelity.outcome(mission)
        if all_files is not None:
            with stopwatch.timed("files"):
                fidelity.export(all_files, outcome.metrics)
                all_files.write_json(FLIGHT, mission.flight.to_dict())
        stopwatch.total_s["total"] = time.perf_counter() - started
        result = fidelity.result(mission, outcome, config.digest())
        if files is not None:
            (files.root / PROGRESS).unlink(missing_ok=True)
            write_atomic(files.root / RESULT, result.to_json())  # last: the mission has finished
        return result

    @classmethod
    def prepare(
        cls,
        config: MissionConfig,
        rock: str,
        replicate: int,
        store: Store | None,
        keeps_everything: bool,
        stopwatch: Stopwatch,
    ) -> MissionContext:
        """Load the rock and draw the errors of what the vehicle is told of it."""
        config.require_flyable()
        cls.require_noticed(config)
        loaded = cls.load(rock, store)
        low, high, home = loaded.vertices_m.min(axis=0), loaded.vertices_m.max(axis=0), config.flight.home_m
        if all(a <= x <= b for a, x, b in zip(low[:2], home, high[:2])) and home[2] < high[2]:
            raise UserError(f"flight.home_m {home} lies inside {rock}; take off beside it")
        of_a_size = cls.simulated(config)
        if cls.follows_size:
            of_a_size = with_size_error(of_a_size, loaded, replicate)
            config = with_true_target(config, loaded)
        return MissionContext(
            config=config,
            rock=loaded,
            replicate=replicate,
            vehicle_config=with_target_error(of_a_size, loaded.sha256, replicate),
            store=store,
            keeps_everything=keeps_everything,
            stopwatch=stopwatch,
        )

    def mission(self, files: RunDirectory | None, progress: RunDirectory | None, log: Log) -> AdaptiveMission:
        """Return the mission to run; what plans gets the vehicle's configuration, never the true one nor the rock."""
        config, context = self.vehicle_config, self.context
        oracle = self.oracle() if gate_class(config.gate.kind).sees_ground_truth else None
        gate = make_gate(config, context.rock.sha256, context.replicate, oracle)
        flight = Flight(config, rock_sha256=context.rock.sha256, replicate=context.replicate)
        recorder = Recorder(config, context.stopwatch, run=files, progress=progress, log=log)
        return AdaptiveMission(
            config, flight, self.camera, self.reconstructor, gate, recorder, self.viewpoints
        )

    def outcome(self, mission: AdaptiveMission) -> Outcome:
        """Run the mission and measure its cloud; a failure and what went wrong on the way are outcomes, too."""
        try:
            cloud = mission.run()
            mission.recorder.reconstructed(cloud)
            metrics = self.measure(cloud)
            if mission.recorder.shares:
                metrics = {**metrics, "expected_share": mission.recorder.shares}
        except MissionFailure as failure:
            return Outcome("failed", failure.reason, failure.message)
        notes = mission.recorder.notes
        if not notes:
            return Outcome("ok", metrics=metrics)
        kinds = sorted(set(notes))
        message = "; ".join(f"{kind}: {notes.count(kind)}" for kind in kinds)
        return Outcome("degraded", kinds[0], message, metrics)

    def result(self, mission: AdaptiveMission, outcome: Outcome, config_digest: str) -> MissionResult:
        context, recorder, flight = self.context, mission.recorder, mission.flight
        timings_s = dict(context.stopwatch.total_s)
        return MissionResult(
            status=outcome.status,
            reason=outcome.reason,
            message=outcome.message,
            config_digest=config_digest,
            rock=context.rock.name,
            replicate=context.replicate,
            metrics=outcome.metrics,
            trace=recorder.trace,
            timings_s=timings_s,
            costs={
                "images": float(recorder.images),
                "registered_images": float(recorder.registered_images),
                "flight_time_s": flight.flight_time_s,
                "path_length_m": flight.path_length_m,
                "energy_wh": flight.energy_wh,
                "wall_s": timings_s["total"],
            },
            provenance={
                **provenance(),
                **used(),
                "rock_sha256": context.rock.sha256,
                "fidelity": self.name,
                "condition": context.config.condition,
                **self.facts,
            },
            condition=context.config.condition,
        )
