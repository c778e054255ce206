"""Would a planner that knew the surface do better? Rows like those of `research.planned_photographs`, for the same table.

    python -m research.known_surface known_surface.csv part-0 part-1 ...

GROUND TRUTH: from the same ten seeds the planner's estimate of the surface is replaced by the true one, or all further views are
chosen together on it before they are flown: one after another, then exchanged one at a time in three rounds.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
import open3d as o3d

from nbv import viewpoints
from nbv.cache import Recent
from nbv.config import load_condition, preset, under
from nbv.geometry.carving import Solid
from nbv.geometry.frames import directions_from
from nbv.geometry.stereo_chance import good_view, reconstruction_probability
from nbv.rocks.catalogue import load_rock
from nbv.scorers import prediction, registry
from nbv.types import Floats, Ints, Viewpoint
from research import write_rows
from research.adaptive_plans import BASE
from research.planned_photographs import CONTROL, HEAD, flown, plans, read, table

NUMBER, CELLS, ROUNDS = 24, 40, 3
TEN = plans(NUMBER)["10 seeds on the paper's rings, by *predicted*"]
COMMON = under(preset("campaign").with_values(BASE), load_condition("indoors"))
CONFIG = COMMON.with_values(TEN)
KNOWN, PAIRS, RULES = (
    "10 seeds, surface known",
    "all views together, by pairs",
    "all views together, by the rules",
)


def true_solid(vertices_m: Floats, faces: Ints) -> Solid:
    """What the true surface encloses or crosses, in cubes."""
    cell_m = float(vertices_m[:, 2].max()) / CELLS
    low = np.append(vertices_m[:, :2].min(axis=0) - 2 * cell_m, 0.0)
    shape = np.ceil((vertices_m.max(axis=0) + 2 * cell_m - low) / cell_m).astype(int)
    middles = o3d.core.Tensor((low + (np.argwhere(np.ones(shape)) + 0.5) * cell_m).astype(np.float32))
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(vertices_m.astype(np.float32), faces.astype(np.uint32))
    inside = scene.compute_occupancy(middles, nsamples=3).numpy() > 0
    inside |= scene.compute_distance(middles).numpy() < 0.5 * cell_m
    return Solid(low, cell_m, inside.reshape(shape))


def together(solid: Solid, vertices_m: Floats, by_rules: bool) -> list[Viewpoint]:
    """The seeds and the views beside them with the largest mean chance over the observable surface."""
    rng = np.random.default_rng(0)
    samples, normals, _ = solid.surface(rng.permutation(vertices_m)[:60_000], 700, rng)
    seeds = viewpoints.seed_viewpoints(CONFIG)
    pool = [*viewpoints.raw_candidates(CONFIG), *viewpoints.ring_candidates(CONFIG)]
    views = seeds + [view for view in pool if view.position_m[2] >= CONFIG.pool.min_altitude_m]
    at = np.array([view.position_m for view in views])
    shell = prediction._visibility(samples, normals, viewpoints.camera_shell(CONFIG), CONFIG, solid)[0]
    known = shell.sum(axis=0) >= prediction.FEWEST_OBSERVING
    seen, incidence = prediction._visibility(samples[known], normals[known], at, CONFIG, solid)
    good, toward = good_view(seen, incidence), directions_from(CONFIG.target_m, at)
    contrast = np.full(int(known.sum()), prediction.CONTRAST)

    def by_pairs(chosen: list[int]) -> float:
        worth = prediction._worth_of_pairs(good[chosen], toward[chosen], CONFIG.dense)
        return float(prediction._chance(worth).mean())

    def rules(chosen: list[int]) -> float:
        of = seen[chosen], incidence[chosen], contrast, toward[chosen], CONFIG.dense
        return float(reconstruction_probability(*of, prediction.ANGLE_DECAY_PER_DEG).mean())

    def improved(chosen: list[int], k: int, value: Callable[[list[int]], float]) -> list[int]:
        others = [c for c in range(len(seeds), len(views)) if c not in chosen]
        return max(([*chosen[:k], c, *chosen[k + 1 :]] for c in [*chosen[k : k + 1], *others]), key=value)

    chosen = list(range(len(seeds)))
    for k in range(len(seeds), NUMBER):
        chosen = improved(chosen, k, by_pairs)
    for k in [*range(len(seeds), NUMBER)] * ROUNDS:
        chosen = improved(chosen, k, rules if by_rules else by_pairs)
    return [views[c] for c in chosen]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("file", type=Path)
    parser.add_argument("targets", nargs="*")
    file, targets = parser.parse_args().file, parser.parse_args().targets
    carved, seeds_of, rows = prediction.carved, viewpoints.ViewpointSource.seeds, read(file)
    asked = {CONTROL: plans(NUMBER)[CONTROL], "10 seeds, by *predicted*": TEN, KNOWN: TEN}
    asked |= {plan: {**TEN, "seeds": NUMBER} for plan in (PAIRS, RULES)}
    for target in targets:
        rock = load_rock(target)
        solid = true_solid(np.asarray(rock.vertices_m), np.asarray(rock.faces))
        for plan, values in asked.items():
            prediction.carved, viewpoints.ViewpointSource.seeds = carved, seeds_of
            registry._KNOWN_GAINS = Recent(1)  # of the same states by another surface
            if plan == KNOWN:
                prediction.carved = lambda *_, known=solid, **__: known
            if plan in (PAIRS, RULES):
                views = together(solid, np.asarray(rock.vertices_m), plan == RULES)
                viewpoints.ViewpointSource.seeds = lambda *_, views=views: views
            key = plan, target, NUMBER, 0
            rows[key] = {**dict(zip(HEAD, key)), **flown(COMMON.with_values(values), target, 0)}
            print(rows[key], flush=True)
            write_rows(file, HEAD, rows.values())
    print("\n".join(table(rows)))


if __name__ == "__main__":
    main()
