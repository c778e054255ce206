"""Whether planning can pay on one target: the greedy oracle against the best plain plan, in geometric missions."""

from __future__ import annotations

from dataclasses import dataclass

from nbv.geometric.curve_fidelity import run_curve_mission
from tuner.comparison.curves import CEILING, LITTLE, Suite, comparison_plans, require_room
from tuner.problem.baselines import ORBITS
from tuner.problem.instances import Instance

ORBIT_NUMBERS = tuple(range(12, 49, 4))


@dataclass(frozen=True)
class Ceiling:
    """What there is to gain on one target with a number of photographs, F-scores at 48 mm in percent."""

    target: str
    photographs: int
    best_plain: str
    plain_percent: float
    oracle_percent: float
    orbit_needs: int | None  # fewest photographs with which two rings reach 98 %; None: 48 do not

    @property
    def verdict(self) -> str:
        points = max(self.oracle_percent - self.plain_percent, 0.0)
        if points < LITTLE:
            return f"no planner can be expected to gain more than {points:.1f} points here: fly {self.best_plain}"
        return f"up to {points:.1f} points: try planners"


def ceiling(target: str, photographs: int = 24) -> Ceiling:
    """Fly the oracle and the plain plans on ``target``; `UserError` where there is no such target, or no room around it."""
    places, reached = (Instance(target),), dict[str, float]()
    suite = Suite(places, tuple(sorted({*ORBIT_NUMBERS, photographs})))
    require_room(suite)
    for name in (*ORBITS, CEILING):
        numbers = suite.numbers if name == "orbit-two" else (photographs,)
        (plan,) = comparison_plans(Suite(places, numbers), {name: None}).values()
        for run, config in plan.strategies.items():
            metrics = run_curve_mission(config, target).metrics or {}
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
        orbit_needs=next(enough, None),
    )
