"""Whether planning can pay on one target: the greedy oracle against the best plain plan, in geometric missions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from nbv.cache import Store
from nbv.geometric.curve_fidelity import run_curve_mission
from nbv.geometry.sampling import sample_surface
from nbv.rocks import Rock, load_coarse_rock
from tuner.comparison.advice import CEILING, LITTLE
from tuner.comparison.curves import Suite, comparison_plans, require_room
from tuner.problem.baselines import ORBITS
from tuner.problem.instances import Instance
from tuner.problem.search_space import builtin

ORBIT_NUMBERS = tuple(range(12, 49, 4))
POCKET_DEPTH = 0.05  # of the height: surface so far inside the convex hull lies in a pocket


@dataclass(frozen=True)
class Ceiling:
    """What there is to gain on one target with a number of photographs, F-scores at 48 mm in percent."""

    target: str
    photographs: int
    best_plain: str
    plain_percent: float
    oracle_percent: float
    height_m: float
    pocket_percent: float  # of the surface
    orbit_needs: int | None  # fewest photographs with which two rings reach 98 %; None: 48 do not

    @property
    def verdict(self) -> str:
        """One sentence."""
        points = max(self.oracle_percent - self.plain_percent, 0.0)
        if points < LITTLE:
            return f"no planner can be expected to gain more than {points:.1f} points here: fly {self.best_plain}"
        return f"up to {points:.1f} points: try planners"


def pocket_percent(rock: Rock) -> float:
    """Share of a target's surface above the ground that lies well inside its convex hull."""
    samples_m, _ = sample_surface(rock.vertices_m, rock.faces, 3000, 0)
    samples_m = samples_m[samples_m[:, 2] > 0.0]
    planes = ConvexHull(rock.vertices_m).equations
    depth_m = -(samples_m @ planes[:, :3].T + planes[:, 3]).max(axis=1)
    return 100.0 * float((depth_m > POCKET_DEPTH * rock.vertices_m[:, 2].max()).mean())


def ceiling(target: str, photographs: int = 24) -> Ceiling:
    """Fly the oracle and the plain plans on ``target``; `UserError` where there is no such target, or no room around it."""
    rock, reached = load_coarse_rock(target, Store()), dict[str, float]()
    places = (Instance(target),)
    suite = Suite(places, tuple(sorted({*ORBIT_NUMBERS, photographs})))
    require_room(suite)
    for name in (*ORBITS, CEILING):
        numbers = suite.numbers if name == "orbit-two" else (photographs,)
        (plan,) = comparison_plans(Suite(places, numbers), {name: None}).values()
        for run, config in plan.strategies.items():
            metrics = run_curve_mission(builtin(config), target).metrics or {}
            reached[run] = float(metrics["curve"][-1][1]) if "curve" in metrics else 0.0
    plain = {name: reached[f"{name}-{photographs}"] for name in ORBITS}
    best = max(plain, key=plain.__getitem__)
    enough = (n for n in suite.numbers if reached[f"orbit-two-{n}"] >= suite.score)
    return Ceiling(
        target=target,
        photographs=photographs,
        best_plain=best,
        plain_percent=plain[best],
        oracle_percent=reached[CEILING],
        height_m=float(np.max(rock.vertices_m[:, 2])),
        pocket_percent=pocket_percent(rock),
        orbit_needs=next(enough, None),
    )
