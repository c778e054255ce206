"""From a configuration to a result document: what distinguishes one kind of mission from another, and what all share."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from nbv.cache import Store
from nbv.config import MissionConfig
from nbv.errors import MissionFailure
from nbv.flight import Flight
from nbv.gates import GroundTruthOracle, Oracle, gate_class, make_gate
from nbv.mission.function import Keep, Log, no_log
from nbv.mission.loop import AdaptiveMission
from nbv.mission.recorder import Recorder
from nbv.mission.result import MissionResult, Status
from nbv.mission.run_directory import PROGRESS, RunDirectory
from nbv.mission.target_prior import with_size_error, with_target_error, with_true_target
from nbv.provenance import provenance
from nbv.rocks import Rock, load_rock
from nbv.stopwatch import Stopwatch
from nbv.terrain import buried_rock
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
    load: Callable[[str, Store | None], Rock] = staticmethod(load_rock)  # the rock of a name

    def __init__(self, context: MissionContext) -> None:
        self.context, self.believed = context, context.believed

    def oracle(self) -> Oracle:
        """What the oracle gates, and nothing else that plans, may ask: here the true surface."""
        rock = self.context.rock
        return GroundTruthOracle(rock.vertices_m, rock.faces, self.context.config)

    @staticmethod
    def simulated(config: MissionConfig) -> MissionConfig:
        """``config`` without the errors of the vehicle's knowledge that this fidelity leaves out."""
        return config

    @abstractmethod
    def measure(self, cloud: Cloud) -> dict[str, Any]:
        """The metrics of the mission's cloud; `MissionFailure` where it has none."""

    @abstractmethod
    def export(self, run: RunDirectory, metrics: dict[str, Any]) -> None:
        """Write what a whole run directory holds of this fidelity; ``metrics`` are empty when the mission failed."""

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
        with_oracle: bool = False,
    ) -> MissionResult:
        """Fly one mission and measure it: a `nbv.mission.function.MissionFunction`.

        Parameters
        ----------
        config, rock, replicate, directory, keep
            As in `MissionFunction`.
        overwrite
            Whether a finished mission in ``directory`` may be replaced.
        cache
            Keep what missions share in the user's store, or in the one given; the outcome is the same. False: no store is
            read or written.
        log
            Called with an event's name and its facts as the mission goes on.
        with_oracle
            Record, beside every decision, what an oracle would have gained from each scorer's best candidate.
        """
        started = time.perf_counter()
        digest = config.digest()
        config.require_seeds_above_ground()
        store = cache if isinstance(cache, Store) else Store() if cache else None
        found = cls.load(rock, store)
        subject = buried_rock(found, config)
        belief = with_target_error(
            with_size_error(cls.simulated(config), subject, replicate), subject.sha256, replicate
        )
        config = with_true_target(config, subject)
        run = RunDirectory(directory, overwrite=overwrite) if directory is not None else None
        if run is not None:
            run.write_config(config.to_dict())
        full_run = run if keep == "all" else None

        def noted(event: str, facts: dict[str, Any]) -> None:
            if run is not None and event in ("seed", "capture"):
                run.write_progress(recorder.images, config.seed.total + config.adaptive_budget)
            log(event, facts)

        log(
            "start",
            {
                "rock": subject.name,
                "replicate": replicate,
                "seeds": config.seed.total,
                "budget": config.adaptive_budget,
                "gate": config.gate.kind,
            },
        )
        stopwatch = Stopwatch()
        keeps_everything = full_run is not None
        fidelity = cls(MissionContext(config, subject, replicate, belief, store, keeps_everything, stopwatch))
        asked = with_oracle or gate_class(config.gate.kind).sees_ground_truth
        oracle = fidelity.oracle() if asked else None
        flown = fidelity.believed  # nothing that flies or plans gets the other one, nor the rock
        gate = make_gate(flown, subject.sha256, replicate, oracle)
        flight = Flight(flown, rock_sha256=subject.sha256, replicate=replicate)
        recorder = Recorder(
            flown, flight, stopwatch, run=full_run, oracle=oracle if with_oracle else None, log=noted
        )
        mission = AdaptiveMission(
            flown, flight, fidelity.camera, fidelity.reconstructor, gate, recorder, fidelity.viewpoints
        )
        status: Status = "ok"
        reason = message = ""
        metrics: dict[str, Any] = {}
        try:
            cloud = mission.run()
            log("metrics", {})
            if full_run is not None:
                full_run.write_cloud("dense.ply", cloud)
            metrics = fidelity.measure(cloud)
        except MissionFailure as failure:
            status, reason, message = "failed", failure.reason, failure.message
        else:
            if recorder.notes:
                kinds = sorted(set(recorder.notes))
                message = "; ".join(f"{kind}: {recorder.notes.count(kind)}" for kind in kinds)
                status, reason = "degraded", kinds[0]
        if full_run is not None:
            fidelity.export(full_run, metrics)
            full_run.write_json("flight.json", flight.to_dict())
        wall_s = time.perf_counter() - started
        stopwatch.total_s["total"] = wall_s
        result = MissionResult(
            status=status,
            reason=reason,
            message=message,
            config_digest=digest,
            rock=subject.name,
            replicate=replicate,
            metrics=metrics,
            trace=recorder.trace,
            timings_s=dict(stopwatch.total_s),
            costs={
                "images": float(recorder.images),
                "registered_images": float(recorder.registered_images),
                "flight_time_s": flight.flight_time_s,
                "path_length_m": flight.path_length_m,
                "energy_wh": flight.energy_wh,
                "wall_s": wall_s,
            },
            provenance={
                **provenance(),
                "rock_sha256": found.sha256,
                "fidelity": fidelity.name,
                "condition": config.condition,
                **fidelity.facts,
            },
            condition=config.condition,
        )
        if full_run is not None:
            full_run.write_json("provenance.json", result.provenance)
        if run is not None:
            (run.root / PROGRESS).unlink(missing_ok=True)
            run.write_result(result.to_json())
        log("finished", {"status": result.status, "reason": result.reason, "message": result.message})
        return result
