"""The closed loop of the paper's Fig. 1: seed phase, adaptive phase, finish."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from nbv.config import MissionConfig
from nbv.errors import MissionFailure
from nbv.flight import Flight
from nbv.gates import Gate, gate_features, make_gate, make_oracle, oracle_rewards
from nbv.mission.planning_state import save_state
from nbv.mission.result import IterationRecord, MissionResult, Status
from nbv.mission.run_directory import RunDirectory
from nbv.scorers import rank_candidates
from nbv.sparse.knn import knn_statistics
from nbv.types import (
    CandidatePool,
    Capture,
    Cloud,
    GateDecision,
    PlanningState,
    Ranking,
    Reconstructor,
    UpdateReport,
    Viewpoint,
)
from nbv.viewpoints import candidate_pool, seed_viewpoints

if TYPE_CHECKING:
    from nbv.evaluation import Evaluation
    from nbv.photogrammetric.reconstructor import PhotogrammetricReconstructor
    from nbv.rocks import Rock

Log = Callable[[str, dict[str, Any]], None]


def _silent(event: str, facts: dict[str, Any]) -> None:
    pass


@dataclass
class AdaptiveMission:
    """The state that the loop carries from capture to capture."""

    config: MissionConfig
    take_photograph: Callable[[Viewpoint, np.ndarray], Capture]
    reconstructor: Reconstructor
    gate: Gate
    flight: Flight
    # Simulation only: what an oracle would have thought of both scorers' choices, logged after the decision.
    shadow: Callable[[PlanningState, CandidatePool, dict[str, Ranking]], dict[str, float]] | None = None
    run: RunDirectory | None = None
    log: Log = _silent
    landed: Callable[[], None] | None = None  # after the last photograph, before the dense stage
    captures: list[Capture] = field(default_factory=list)
    trace: list[IterationRecord] = field(default_factory=list)
    timings_s: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    report: UpdateReport | None = None

    # -- the three acts ------------------------------------------------------------------------------

    def fly_seed_phase(self) -> None:
        """Phase 1: the stratified ring orbit and the seed model."""
        self.flight.take_off()
        for viewpoint in seed_viewpoints(self.config):
            self._capture(viewpoint)
        with self._timed("bootstrap"):
            self.report = self.reconstructor.bootstrap(self.captures)
        self._add_timings(self.report)
        model = self.report.model
        if len(model.camera_names) < len(self.captures):
            self.notes.append("unregistered_seed")
        self.log("seed-model", {"points": len(model.points_m), "registered": len(model.camera_names),
                                "captures": len(self.captures), "alignment_rms_m": model.alignment_rms_m})  # fmt: skip

    def fly_adaptive_phase(self) -> None:
        """Phase 2: plan, fly, photograph, update, until the budget is used or the cloud has converged."""
        n_seeds = len(self.captures)
        for iteration in range(self.config.stop.adaptive_budget):
            started = time.perf_counter()
            state = self._planning_state(iteration, n_seeds)
            if self._converged(state.d95_m):
                self.log("converged", {"iteration": iteration, "d95_m": state.d95_m})
                break
            pool = candidate_pool(self.config, state.vehicle_position_m, state.visited_m[n_seeds:])
            if len(pool) == 0:
                self.notes.append("empty_pool")
                self.log("empty-pool", {"iteration": iteration, **pool.counts})
                break
            if self.run is not None:
                save_state(self.run.state_path(iteration), state, pool)
            rankings = rank_candidates(state, pool, self.config)
            decision = self.gate.decide(state, pool, rankings)
            planning_s = time.perf_counter() - started
            rewards = self._shadow_rewards(state, pool, rankings)
            self._count("planning", planning_s)
            self._fly_photograph_update(state, pool, rankings, decision, rewards, planning_s)

    def finish(self) -> Cloud:
        """Fly home and reconstruct the dense cloud."""
        self.flight.return_and_land()
        if self.landed is not None:
            self.landed()
        with self._timed("dense"):
            return self.reconstructor.finish()

    # -- the steps of an iteration -------------------------------------------------------------------

    def _planning_state(self, iteration: int, n_seeds: int) -> PlanningState:
        assert self.report is not None
        stop, model = self.config.stop, self.report.model
        knn = knn_statistics(
            model.points_m, k=stop.knn_neighbours, region=stop.knn_region, target_m=self.config.target_m,
            box_half_extent_m=self.config.shared.box_half_extent_m,
        )  # fmt: skip
        return PlanningState(
            model=model,
            visited_m=np.array([capture.viewpoint.position_m for capture in self.captures]),
            n_seeds=n_seeds,
            vehicle_position_m=self.flight.position_m,
            vehicle_heading_rad=self.flight.heading_rad,
            captures_used=len(self.captures) - n_seeds,
            adaptive_budget=stop.adaptive_budget,
            d95_m=knn.d95_m,
            iteration=iteration,
        )

    def _shadow_rewards(
        self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]
    ) -> dict[str, float]:
        if self.shadow is None:
            return {}
        with self._timed("shadow_oracle"):
            return self.shadow(state, pool, rankings)

    def _converged(self, d95_m: float) -> bool:
        return self.config.stop.criterion in ("both", "knn") and d95_m <= self.config.stop.knn_threshold_m

    def _fly_photograph_update(
        self,
        state: PlanningState,
        pool: CandidatePool,
        rankings: dict[str, Ranking],
        decision: GateDecision,
        rewards: dict[str, float],
        planning_s: float,
    ) -> None:
        viewpoint = pool.viewpoint(decision.ranking.top)
        flown_s, flown_m = self.flight.flight_time_s, self.flight.path_length_m
        capture = self._capture(viewpoint)
        started = time.perf_counter()
        self.report = self.reconstructor.add(capture)
        update_s = time.perf_counter() - started
        self._count("update", update_s)
        self._add_timings(self.report)
        if not self.report.registered:
            self.notes.append("unregistered_image")
        record = IterationRecord(
            iteration=state.iteration,
            pool_size=len(pool),
            pool_counts=pool.counts,
            d95_m=state.d95_m,
            n_points=len(state.model.points_m),
            n_registered=len(state.model.camera_names),
            alignment_rms_m=state.model.alignment_rms_m,
            scorer=decision.ranking.scorer,
            reason=decision.reason,
            gate_details=decision.details,
            oracle_rewards=rewards,
            features=gate_features(state, self.config),
            top={name: _top(ranking, pool) for name, ranking in rankings.items()},
            chosen=viewpoint.id,
            registered=self.report.registered,
            message=self.report.message,
            leg_duration_s=self.flight.flight_time_s - flown_s,
            leg_length_m=self.flight.path_length_m - flown_m,
            update_s=update_s,
            planning_s=planning_s,
        )
        self.trace.append(record)
        if self.run is not None:
            self.run.append_trace(asdict(record))
        self.log("capture", {"iteration": state.iteration, "chosen": viewpoint.id, "scorer": record.scorer,
                             "d95_m": state.d95_m, "registered": record.registered,
                             "points": len(self.report.model.points_m)})  # fmt: skip

    def _capture(self, viewpoint: Viewpoint) -> Capture:
        """Fly to a viewpoint and photograph the target from where the vehicle really is."""
        position_m = self.flight.fly_to(viewpoint)
        with self._timed("photograph"):
            capture = self.take_photograph(viewpoint, position_m)
        self.captures.append(capture)
        if self.run is not None and capture.image is not None:
            self.run.write_image(capture.name, capture.image)
        if viewpoint.band == "seed":
            self.log("seed", {"index": len(self.captures) - 1, "id": viewpoint.id})
        return capture

    # -- bookkeeping ---------------------------------------------------------------------------------

    def _timed(self, stage: str) -> _Timer:
        return _Timer(self, stage)

    def _count(self, stage: str, seconds: float) -> None:
        self.timings_s[stage] = self.timings_s.get(stage, 0.0) + seconds

    def _add_timings(self, report: UpdateReport) -> None:
        for stage, seconds in report.timings_s.items():
            self._count(f"sparse.{stage}", seconds)


class _Timer:
    def __init__(self, mission: AdaptiveMission, stage: str) -> None:
        self._mission, self._stage = mission, stage

    def __enter__(self) -> None:
        self._started = time.perf_counter()

    def __exit__(self, *exc: object) -> None:
        self._mission._count(self._stage, time.perf_counter() - self._started)


def _top(ranking: Ranking, pool: CandidatePool) -> dict[str, float | str]:
    best = ranking.top
    terms = {name: float(values[best]) for name, values in ranking.terms.items()}
    return {"candidate": pool.ids[best], "score": float(ranking.scores[best]), **terms}


def _scores_at(
    agreeing_views: int,
    reconstructor: PhotogrammetricReconstructor,
    evaluate: Callable[[Cloud, Rock, MissionConfig], Evaluation],
    subject: Rock,
    config: MissionConfig,
    configured: dict[str, Any],
) -> dict[str, Any]:
    """Both surfaces' scores of the flown mission at another fusion strictness, or why there are none."""
    if agreeing_views == config.dense.agreeing_views:
        return {surface: configured[surface] for surface in ("whole", "observable")}
    try:
        metrics = evaluate(reconstructor.cloud_at(agreeing_views), subject, config).metrics
    except MissionFailure as failure:
        return {"failed": failure.reason}
    return {surface: metrics[surface] for surface in ("whole", "observable")}


@dataclass(frozen=True)
class Outcome:
    """How a flown mission ended."""

    status: Status
    reason: str
    message: str
    metrics: dict[str, Any]  # empty when failed


def fly(mission: AdaptiveMission, measure: Callable[[Cloud], dict[str, Any]]) -> Outcome:
    """All three acts, then ``measure`` on the dense cloud; a `MissionFailure` becomes a failed outcome."""
    try:
        mission.fly_seed_phase()
        mission.fly_adaptive_phase()
        mission.log("dense", {})
        metrics = measure(mission.finish())
    except MissionFailure as failure:
        return Outcome("failed", failure.reason, failure.message, {})
    if not mission.notes:
        return Outcome("ok", "", "", metrics)
    notes = sorted(set(mission.notes))
    message = "; ".join(f"{note}: {mission.notes.count(note)}" for note in notes)
    return Outcome("degraded", notes[0], message, metrics)


def mission_result(
    mission: AdaptiveMission,
    outcome: Outcome,
    rock: Rock,
    replicate: int,
    wall_s: float,
    facts: dict[str, Any],
) -> MissionResult:
    """The result document of a flown mission; ``facts`` go into the provenance."""
    from nbv.provenance import provenance

    mission.timings_s["total"] = wall_s
    registered = len(mission.report.model.camera_names) if mission.report is not None else 0
    return MissionResult(
        status=outcome.status,
        reason=outcome.reason,
        message=outcome.message,
        config_digest=mission.config.digest(),
        rock=rock.name,
        replicate=replicate,
        metrics=outcome.metrics,
        trace=mission.trace,
        timings_s=mission.timings_s,
        costs={
            "images": float(len(mission.captures)),
            "registered_images": float(registered),
            "flight_time_s": mission.flight.flight_time_s,
            "path_length_m": mission.flight.path_length_m,
            "wall_s": wall_s,
        },
        provenance={**provenance(), "rock_sha256": rock.sha256, **facts},
    )


def run_mission(
    config: MissionConfig,
    rock: str,
    replicate: int = 0,
    directory: Path | None = None,
    *,
    keep: Literal["all", "summary"] = "all",
    overwrite: bool = False,
    cache: bool = True,
    agreement_levels: Sequence[int] = (),
    log: Log = _silent,
) -> MissionResult:
    """Fly one complete photogrammetric mission and measure it against the ground truth.

    The result is a function of (config, rock, replicate, backends): arrival errors and sensor noise are
    drawn per (rock, replicate, viewpoint).

    Parameters
    ----------
    config
        The mission's configuration.
    rock
        A catalogue name or the path of a mesh.
    replicate
        Index of the draw of arrival errors and sensor noise.
    directory
        Where the run directory is written; ``None`` writes nothing.
    keep
        ``"all"`` leaves images, states, models and clouds in ``directory``; ``"summary"`` only the
        configuration, the trace and ``mission.json``.
    cache
        Keep photographs, features, pairs, models, clouds and metrics in the user's store; the outcome is
        the same.
    agreement_levels
        Also measure the same flight at these values of ``dense.agreeing_views`` (none below the
        configured one): ``metrics["agreement"]["5"]`` then holds the ``whole`` and ``observable`` scores
        that a mission configured with 5 would have, or ``failed`` with the reason. Depth maps, the dear
        part, are shared.
    log
        Called with an event name and its facts as the mission goes on.

    Returns
    -------
    MissionResult
        Also for a mission that failed: ``status`` and ``reason`` say so.

    Raises
    ------
    UserError
        Unknown rock, bad mesh, unwritable directory, missing backend.
    """
    from nbv.cache import Store
    from nbv.evaluation import evaluate_cloud
    from nbv.memory import give_back_freed_memory
    from nbv.photogrammetric.cached_sequences import CachedEvaluation
    from nbv.photogrammetric.cached_stages import CachedStudio
    from nbv.photogrammetric.reconstructor import PhotogrammetricReconstructor
    from nbv.photogrammetric.studio import Studio
    from nbv.rocks import load_rock
    from nbv.scene import Renderer, build_scene, make_renderer
    from nbv.threads import limit_threads

    limit_threads()
    store = Store() if cache else None
    started = time.perf_counter()
    subject = load_rock(rock)
    run = RunDirectory(directory, overwrite=overwrite) if directory is not None else None
    if run is not None:
        run.write_config(config.to_dict())
    full_run = run if keep == "all" else None
    log("start", {"rock": subject.name, "replicate": replicate, "seeds": sum(config.seed.ring_azimuth_counts),
                  "budget": config.stop.adaptive_budget, "gate": config.gate.kind})  # fmt: skip

    def prepare_renderer() -> Renderer:
        with mission._timed("scene"):
            return make_renderer(build_scene(subject, config.scene, config.camera), config.scene.backend)

    def put_away() -> None:
        # The dense stage decides how much memory a mission takes: the scene, 0.15 GB, goes before it.
        studio.close()
        give_back_freed_memory()

    studio = Studio(prepare_renderer, subject, replicate, config)
    photographer = CachedStudio(studio, store, subject, replicate, config) if store is not None else studio
    reconstructor = PhotogrammetricReconstructor(config, store, keep_sparse=full_run is not None)
    evaluate = CachedEvaluation(store) if store is not None else evaluate_cloud
    oracle = make_oracle(config, subject)  # for the oracle gates, and for the shadow log of all others
    mission = AdaptiveMission(
        config=config,
        take_photograph=photographer.take_photograph,
        reconstructor=reconstructor,
        gate=make_gate(config, rock=subject, replicate=replicate, oracle=oracle),
        shadow=lambda state, pool, rankings: oracle_rewards(oracle, state, pool, rankings),
        flight=Flight(config, rock_sha256=subject.sha256, replicate=replicate),
        run=full_run,
        log=log,
        landed=put_away,
    )

    def measure(cloud: Cloud) -> dict[str, Any]:
        log("metrics", {"points": len(cloud)})
        with mission._timed("evaluation"):
            evaluation = evaluate(cloud, subject, config)
        metrics = evaluation.metrics
        if agreement_levels:
            with mission._timed("agreement_levels"):
                metrics["agreement"] = {
                    str(level): _scores_at(level, reconstructor, evaluate, subject, config, metrics)
                    for level in agreement_levels
                }
        if full_run is not None:
            full_run.write_cloud("dense.ply", cloud)
            full_run.write_cloud("cleaned.ply", evaluation.cleaned)
            full_run.write_json("metrics.json", {"metrics": metrics, "cleaning": evaluation.cleaning})
        return metrics

    outcome = fly(mission, measure)
    if full_run is not None and mission.report is not None:
        reconstructor.export_sparse(full_run.root / "sparse" / "0")

    result = mission_result(
        mission, outcome, subject, replicate, time.perf_counter() - started,
        {
            "fidelity": "photogrammetric",
            "backend": config.scene.backend,
            "dense_backend": config.dense.backend,
        },
    )  # fmt: skip
    if run is not None:
        if full_run is not None:
            full_run.write_json("flight.json", mission.flight.to_dict())
            full_run.write_json("provenance.json", result.provenance)
        run.write_result(result.to_json())
    log("finished", {"status": result.status, "reason": result.reason, "message": result.message})
    return result
