"""A complete mission in milliseconds: the same loop, scorers, gates and flight over simulated tracks."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from nbv.cache import Store
from nbv.config import MissionConfig
from nbv.errors import UserError
from nbv.flight import Flight, arrival_position
from nbv.gates import make_gate, make_oracle, oracle_rewards
from nbv.geometric.completeness import sample_probability
from nbv.geometric.metrics import predicted_metrics
from nbv.geometric.reconstructor import MODEL_VERSION, GeometricReconstructor, StandIn
from nbv.geometric.world import WORLD_VERSION, GeometricWorld, load_world
from nbv.geometry.frames import look_at
from nbv.mission.loop import AdaptiveMission, Log, _silent, fly, mission_result
from nbv.mission.result import MissionResult
from nbv.mission.run_directory import RunDirectory
from nbv.rocks import Rock, load_rock
from nbv.types import Capture, Cloud, Floats, Viewpoint
from nbv.viewpoints import raw_candidates, seed_viewpoints


def run_geometric_mission(
    config: MissionConfig,
    rock: str,
    replicate: int = 0,
    directory: Path | None = None,
    *,
    keep: Literal["all", "summary"] = "summary",
    overwrite: bool = False,
    cache: bool = True,
    shadow: bool = False,
    stand_in: StandIn | None = None,
    log: Log = _silent,
) -> MissionResult:
    """Fly one mission without images and predict its completeness.

    It takes the same arguments and returns the same document as `nbv.mission.loop.run_mission`, so it is a
    mission runner for campaigns (``nbv.geometric:run_geometric_mission``); ``provenance["fidelity"]`` and
    ``metrics["fidelity"]`` say ``geometric``. The result is a function of (config, rock, replicate).

    Parameters
    ----------
    cache
        Keep the rock's ray casting in the user's store; the outcome is the same.
    shadow
        Also log what an oracle would have thought of both scorers' choices, as photogrammetric missions
        do; it takes longer than everything else together.
    stand_in
        The free constants; default: the calibrated ones.

    Raises
    ------
    UserError
        Unknown rock, bad mesh, unwritable directory.
    """
    started = time.perf_counter()
    subject = load_rock(rock)
    run = RunDirectory(directory, overwrite=overwrite) if directory is not None else None
    if run is not None:
        run.write_config(config.to_dict())
    full_run = run if keep == "all" else None
    world = _world(subject, config, cache)
    log("start", {"rock": subject.name, "replicate": replicate, "seeds": sum(config.seed.ring_azimuth_counts),
                  "budget": config.stop.adaptive_budget, "gate": config.gate.kind})  # fmt: skip

    def take_photograph(viewpoint: Viewpoint, position_m: Floats) -> Capture:
        pose = _aim(tuple(position_m.tolist()), config.target_m)
        return Capture(f"{viewpoint.id}.png", viewpoint, pose, None)

    reconstructor = GeometricReconstructor(world, config, subject.sha256, replicate, stand_in)
    oracle = make_oracle(config, subject) if shadow else None
    mission = AdaptiveMission(
        config=config,
        take_photograph=take_photograph,
        reconstructor=reconstructor,
        gate=make_gate(config, rock=subject, replicate=replicate, oracle=oracle),
        shadow=None if oracle is None else lambda s, p, r: oracle_rewards(oracle, s, p, r),
        flight=Flight(config, rock_sha256=subject.sha256, replicate=replicate),
        run=full_run,
        log=log,
    )

    def measure(cloud: Cloud) -> dict[str, Any]:
        log("metrics", {"points": len(cloud.points_m)})
        if full_run is not None:
            full_run.write_cloud("dense.ply", cloud)
        with mission._timed("evaluation"):
            return predicted_metrics(world, reconstructor.predicted(), config)

    outcome = fly(mission, measure)
    result = mission_result(
        mission, outcome, subject, replicate, time.perf_counter() - started,
        {"fidelity": "geometric", "geometric_world_version": WORLD_VERSION,
         "geometric_model_version": MODEL_VERSION},
    )  # fmt: skip
    if run is not None:
        if full_run is not None:
            full_run.write_json("metrics.json", {"metrics": result.metrics})
            full_run.write_json("flight.json", mission.flight.to_dict())
            full_run.write_json("provenance.json", result.provenance)
        run.write_result(result.to_json())
    log("finished", {"status": result.status, "reason": result.reason, "message": result.message})
    return result


def predict_views(
    config: MissionConfig,
    rock: str,
    chosen: Sequence[str],
    replicate: int = 0,
    *,
    stand_in: StandIn | None = None,
    cache: bool = True,
) -> dict[str, Any]:
    """The predicted metrics of the seeds and the candidates ``chosen`` (ids), without planning anything.

    Raises
    ------
    UserError
        Unknown rock, or an id that is no candidate.
    """
    subject = load_rock(rock)
    world = _world(subject, config, cache)
    viewpoints = {v.id: v for v in (*seed_viewpoints(config), *raw_candidates(config))}
    unknown = [name for name in chosen if name not in viewpoints]
    if unknown:
        raise UserError(f"{unknown[0]!r} is no candidate; ids run from cand_000 upwards")
    names = [*(v.id for v in seed_viewpoints(config)), *chosen]
    centers = np.array(
        [arrival_position(viewpoints[n], config.flight, subject.sha256, replicate) for n in names]
    )
    rows = [world.index(name) for name in names]
    model = (stand_in or StandIn()).dense
    return predicted_metrics(world, sample_probability(world, rows, centers, config, model), config)


@lru_cache(maxsize=4096)  # the same viewpoints come back in every mission
def _aim(position_m: tuple[float, ...], target_m: tuple[float, float, float]) -> Floats:
    return look_at(np.array(position_m), np.array(target_m))


_WORLDS: dict[tuple[object, ...], GeometricWorld] = {}


def _world(rock: Rock, config: MissionConfig, cache: bool) -> GeometricWorld:
    """The rock's world; the last few stay in memory, so a campaign in one process loads each once."""
    key = (
        rock.sha256, config.camera, config.scene, config.seed, config.pool, config.target_m,
        config.shared.box_half_extent_m,
    )  # fmt: skip  # all that `nbv.geometric.world` reads, and a little more
    world = _WORLDS.pop(key, None)
    if world is None:
        world = load_world(rock, config, Store() if cache else None)
        while len(_WORLDS) >= 16:
            _WORLDS.pop(next(iter(_WORLDS)))
    _WORLDS[key] = world  # most recently used last
    return world
