"""A pocket as a planner sees it: the hull of the sparse points, the surface carved by coarse depth, the truth.

``python -m research.picture_of_a_pocket OUT.png [TARGET]``: a vertical section, after the seeds of a geometric mission, and the
next view of *predicted* and of the greedy oracle.
"""

from __future__ import annotations

import sys
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import trimesh

from nbv.cache import Store
from nbv.config import MissionConfig
from nbv.gates.ground_truth import GroundTruthOracle
from nbv.geometric.geometric_fidelity import GeometricFidelity
from nbv.planner import Planner
from nbv.rocks import load_coarse_rock
from nbv.scorers.prediction import predict
from nbv.scorers.surface import points_on_rock
from nbv.types import Floats, SparseModel
from tuner.comparison.curves import Suite
from tuner.problem.baselines import baseline, ending_at

NUMBER = 24
HALF_SLICE_M = 0.04


class _Stopped(Exception):
    pass


def after_seeds(config: MissionConfig, target: str) -> tuple[SparseModel, Floats, Floats, float]:
    """The model, the places visited, and where the vehicle is, at the first decision of a geometric mission."""
    seen: list[Any] = []

    def note(planner: Planner, *state: Any) -> None:
        seen.append(state)
        raise _Stopped

    planned, Planner.plan = Planner.plan, note  # type: ignore[method-assign,assignment]
    try:
        GeometricFidelity.run(config, target, cache=Store())
    except _Stopped:
        pass
    finally:
        Planner.plan = planned  # type: ignore[method-assign]
    model, visited_m, _, position_m, heading = seen[0]
    return model, visited_m, position_m, heading


def main() -> None:
    """Draw it."""
    out, target = sys.argv[1], sys.argv[2] if len(sys.argv) > 2 else "machine-0"
    config = ending_at(baseline("predicted").config(Suite((target,)).base), NUMBER)
    model, visited_m, position_m, heading = after_seeds(config, target)
    rock = load_coarse_rock(target, Store())
    carved, points_m = predict(model, config), points_on_rock(model.points_m, config)
    oracle_config = config.changed(gate={"oracle_coverage": "matchable"})
    truth = GroundTruthOracle(rock.vertices_m, rock.faces, oracle_config)
    planner = Planner(config)
    plan = planner.plan(model, visited_m, len(visited_m), position_m, heading)
    pool_m = plan.pool.positions_m
    chosen = {
        "predicted": pool_m[np.argmax(carved.expected_gain(pool_m))],
        "greedy oracle": pool_m[np.argmax([truth.gain(p, truth.coverage(plan.state)) for p in pool_m])],
    }
    toward = chosen["greedy oracle"][:2] - np.array(config.target_m[:2])
    toward = toward / np.linalg.norm(toward)
    across = np.array([-toward[1], toward[0]])

    figure, axes = plt.subplots(1, 2, figsize=(11, 5), constrained_layout=True)
    mesh = trimesh.Trimesh(rock.vertices_m, rock.faces, process=False)
    section = mesh.section(plane_origin=[0, 0, 0], plane_normal=[*across, 0.0])
    left, top = axes
    for k, line in enumerate(section.discrete):
        left.plot(line[:, :2] @ toward, line[:, 2], "k", lw=2, label="truth" if k == 0 else None)
    solid = carved.solid
    u = np.arange(-1.5, 1.5, solid.cell_m / 2)
    z = np.arange(solid.cell_m / 4, 2.2, solid.cell_m / 2)
    grid = np.stack(np.meshgrid(u, z, indexing="ij"), axis=-1)
    place = np.concatenate([grid[..., :1] * toward, grid[..., 1:]], axis=-1)
    index = np.floor((place - solid.low_m) / solid.cell_m).astype(int)
    inside = ((index >= 0) & (index < solid.cells.shape)).all(axis=-1)
    filled = inside & solid.cells[tuple(np.where(inside[..., None], index, 0).reshape(-1, 3).T)].reshape(
        inside.shape
    )
    left.pcolormesh(
        u, z, np.where(filled, 1.0, np.nan).T, cmap="Oranges", vmin=0, vmax=2.5, label="carved surface"
    )
    convex = trimesh.convex.convex_hull(points_m).section(plane_origin=[0, 0, 0], plane_normal=[*across, 0.0])
    for line in convex.discrete:
        left.plot(line[:, :2] @ toward, line[:, 2], "b--", lw=1.5, label="hull")
    near = np.abs(model.depth_m[:, :2] @ across) < HALF_SLICE_M
    depth_m = model.depth_m[near]
    left.plot(depth_m[:, :2] @ toward, depth_m[:, 2], "g.", ms=3, label="coarse depth")
    left.set(aspect="equal", xlim=(-1.5, 1.5), ylim=(0, 2.2))
    left.set(xlabel="m, towards the oracle's view", ylabel="height, m")
    left.set_title(f"{target}, after {len(visited_m)} seeds: section (orange: solid or unknown)")
    left.legend(loc="upper right", fontsize=8)
    top.scatter(mesh.vertices[::7, 0], mesh.vertices[::7, 1], c=mesh.vertices[::7, 2], s=2, cmap="Greys_r")
    top.plot(visited_m[:, 0], visited_m[:, 1], "k^", ms=5, label="seeds")
    for (name, at), mark in zip(chosen.items(), ("bo", "r*"), strict=True):
        top.plot(at[0], at[1], mark, ms=9, label=f"{name}: {at[2]:.1f} m high")
    top.set(aspect="equal", xlabel="m", ylabel="m", title="from above: the next view of each planner")
    top.legend(loc="upper right", fontsize=8)
    figure.savefig(out, dpi=90)


if __name__ == "__main__":
    main()
