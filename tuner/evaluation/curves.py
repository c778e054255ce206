"""Quality over the number of photographs, for any strategies on the same targets, and what follows from it.

A planned strategy runs once, to the largest number, and is read at every number; an orbit is a plan of its own for each. Where
photographs are rendered or given, every number is a mission of its own for all strategies.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nbv.cache import Store, digest
from nbv.config import MissionConfig, preset
from nbv.errors import UserError
from nbv.mission.target_prior import with_size_error
from nbv.photographs import PhotographSet
from nbv.plugins import INTERFACE
from nbv.rocks import load_coarse_rock
from nbv.rocks.catalogue import is_photographed
from nbv.rocks.families import FAMILIES, HELD_OUT_FROM, drawn_by
from nbv.types import Bools, Floats, Ints
from tuner.evaluation.plan import EvaluationPlan
from tuner.missions.job import Trial
from tuner.problem.baselines import PLAN, baseline, ending_at, sees_ground_truth, with_sections_of

BY_HEIGHT, STOPPED = "orbit-by-height", "-stopped"  # derived from the missions of others
TWO_RINGS = "orbit-two"
PHOTOGRAPHS_PER_LOG_HEIGHT = 20.0  # more on a rock 2.7 times as high (docs/results/where_planning_pays.md)
LEVELS = np.arange(6.0, 49.0)  # photographs of a rock 1 m high
THRESHOLDS_PERCENT = np.arange(90.0, 99.6, 0.25)  # predicted F-scores at which a mission stops
BOOTSTRAP, LEAST_TARGETS = 1000, 5  # fewer have no interval
CURVE = "curve"
Interval = tuple[float | None, float | None, float | None]  # a mean and its bounds
# Seeds as few as register, the size of targets known to 20 %, and no weights but its main term for a built-in scorer.
BASE: dict[str, Any] = {
    "dense.agreeing_views": 3,
    "sparse.ground_features": 2000,
    "sparse.min_registered_seeds": 6,
    "seed.count": 12,
    "seed.radius_m": 3.5,
    "seed.lowest_deg": 10.0,
    "seed.second_turn": True,
    "stop.criterion": "budget",
    "gate.oracle_samples": 3000,
}


@dataclass(frozen=True)
class Suite:
    """All that decides a comparison but its strategies: two papers that name the same suite ran the same."""

    targets: tuple[str, ...]
    numbers: tuple[int, ...] = tuple(range(12, 49, 2))
    replicates: int = 1
    score: float = 98.0  # F-score at 48 mm that a target shall reach, in percent
    share: float = 0.75  # of the targets that shall reach it
    fidelity: str = CURVE
    values: Mapping[str, Any] = field(default_factory=lambda: dict(BASE))

    def __post_init__(self) -> None:
        if list(self.numbers) != sorted(set(self.numbers)) or not self.numbers:
            raise UserError(f"numbers of photographs must rise; these are {list(self.numbers)}")
        if self.numbers[0] < self.base.seed.total:
            raise UserError(
                f"the first number is {self.numbers[0]}, below the {self.base.seed.total} seeds; begin there or later"
            )
        if not 0.0 < self.share <= 1.0 or not 0.0 < self.score <= 100.0:
            raise UserError(f"share {self.share:g} must be in (0, 1] and score {self.score:g} in (0, 100]")

    @property
    def base(self) -> MissionConfig:
        """What all strategies have in common."""
        return preset("campaign").with_values(dict(self.values))

    @property
    def measures_every_photograph(self) -> bool:
        """Whether one mission of a planned strategy tells of every number."""
        return self.fidelity == CURVE and not any(map(is_photographed, self.targets))

    @property
    def name(self) -> str:
        """A published name, or one made of the content."""
        content = self.to_dict()
        named = (name for name, suite in SUITES.items() if suite.to_dict() == content)
        return next(named, f"custom-{digest(content)[:8]}")

    def to_dict(self) -> dict[str, Any]:
        """JSON form."""
        lists = {name: list(value) for name, value in vars(self).items() if isinstance(value, tuple)}
        return {**vars(self), **lists, "values": dict(self.values), "interface": INTERFACE}


def drawn_targets(count: int, families: Sequence[str] = tuple(FAMILIES)) -> tuple[str, ...]:
    """Return the first ``count`` held-out rocks of the families, in turn; `UserError` where a family does not exist."""
    for family in families:
        if drawn_by(family) is None:
            raise UserError(f"there is no family {family!r} of rocks; there are {', '.join(FAMILIES)}")
    names = [f"{family}-{HELD_OUT_FROM + k}" for k in range(count) for family in families]
    return tuple(names[:count])


SUITES = {"rocks-1": Suite(drawn_targets(60))}


def require_room(targets: Sequence[str], config: MissionConfig) -> None:
    """Raise `UserError` where a target reaches the views around it."""
    for target in targets:
        if is_photographed(target):
            continue
        vertices_m = load_coarse_rock(target, Store()).vertices_m
        reach_m = float(np.linalg.norm(vertices_m[:, :2], axis=1).max())
        if reach_m >= min(config.pool.radius_m, config.seed.radius_m):
            raise UserError(
                f"{target} reaches {reach_m:.1f} m from its middle, and views stand {config.pool.radius_m:g} m from it; "
                "set pool.radius_m and seed.radius_m to more"
            )


def comparison_plan(suite: Suite, strategies: Mapping[str, MissionConfig | None]) -> EvaluationPlan:
    """Return the missions of a suite.

    ``strategies``: by name; None: the baseline, scorer or gate of that name. Of a configuration its plan is taken,
    and photographs are reconstructed and measured as those of all others are.

    Raises `UserError`: there is no such strategy, or nothing can stop it.
    """
    most, base, configs = suite.numbers[-1], suite.base, dict[str, MissionConfig]()
    for name, given in strategies.items():
        source = TWO_RINGS if name == BY_HEIGHT else name.removesuffix(STOPPED)
        given = None if given is None else with_sections_of(given, PLAN, base)
        planned = given if given is not None else baseline(source).config(ending_at(base, most))
        told = bool(planned.adaptive_budget) and suite.measures_every_photograph
        if name.endswith(STOPPED) and not told:
            raise UserError(f"{name}: only a planner, in missions without photographs, predicts as it goes")
        if told:
            configs[source] = ending_at(planned, most)
        elif planned.adaptive_budget:
            configs |= {f"{source}-{n}": ending_at(planned, n) for n in suite.numbers}
        elif given is not None:
            configs |= {f"{source}-{n}": given.with_values({"seed.count": n}) for n in suite.numbers}
        else:
            configs |= {f"{source}-{n}": baseline(source).orbit(base, n) for n in suite.numbers}
    return EvaluationPlan(configs, suite.targets, suite.replicates, fidelity=suite.fidelity)


@dataclass(frozen=True)
class Series:
    """A strategy at each of its K settings, a number, a level or a threshold, on R targets."""

    name: str
    photographs: Floats  # (K, R)
    scores: Floats  # (K, R) F-score at 48 mm in percent; 0 where the mission failed
    failed: int = 0  # missions

    @property
    def sees_ground_truth(self) -> bool:
        """Whether it is an upper reference, no planner."""
        return sees_ground_truth(self.name.removesuffix(STOPPED))

    def mean_photographs(self, of: Ints) -> Floats:
        """(K,) over the targets ``of``."""
        mean: Floats = self.photographs[:, of].mean(axis=1)
        return mean

    def needed(self, share: float, score: float, of: Ints) -> float | None:
        """Mean photographs of the first setting with which ``share`` of the targets reach ``score``; None: no setting does.

        Nor is a share of nothing ever reached.
        """
        reached: Bools = (self.scores[:, of] >= score).mean(axis=1) >= share - 1e-9
        return float(self.mean_photographs(of)[np.argmax(reached)]) if share and reached.any() else None

    def at(self, number: float, values: Floats) -> Floats:
        """(R,) of ``values`` (K, R) at a mean ``number`` of photographs, between settings in proportion."""
        mean = self.mean_photographs(np.arange(values.shape[1]))
        above = int(np.clip(np.searchsorted(mean, number), 1, len(mean) - 1)) if len(mean) > 1 else 0
        if above == 0:
            return values[0]
        below = above - 1
        part = np.clip((number - mean[below]) / max(mean[above] - mean[below], 1e-12), 0.0, 1.0)
        found: Floats = (1.0 - part) * values[below] + part * values[above]
        return found


def all_series(suite: Suite, strategies: Sequence[str], trials: Sequence[Trial]) -> list[Series]:
    """Return the series of the strategies from the missions that have ended; targets that a strategy lacks are an error."""
    of: dict[str, dict[str, list[Trial]]] = {}
    for trial in trials:
        of.setdefault(trial.strategy, {}).setdefault(trial.rock, []).append(trial)
    return [_series(suite, name, of) for name in strategies]


def _series(suite: Suite, name: str, of: Mapping[str, Mapping[str, list[Trial]]]) -> Series:
    numbers, targets, columns = np.array(suite.numbers), suite.targets, np.arange(len(suite.targets))
    source = TWO_RINGS if name == BY_HEIGHT else name.removesuffix(STOPPED)
    flown = [of[source]] if source in of else [of[f"{source}-{n}"] for n in suite.numbers]
    if source in of:
        curves = np.array([np.mean([_curve(t, numbers) for t in of[source][r]], axis=0) for r in targets])
        scores, told = curves.transpose(1, 2, 0)
        taken = np.repeat(numbers[:, None].astype(float), len(targets), 1)
    else:
        ends = [[[_end(t, n) for t in own[r]] for r in targets] for n, own in zip(suite.numbers, flown)]
        taken, scores = (
            np.array([[np.mean([e[i] for e in r]) for r in row] for row in ends]) for i in (0, 1)
        )
    failed = sum(trial.status == "failed" for own in flown for trials in own.values() for trial in trials)
    if name == BY_HEIGHT:
        heights_m = [_believed_height_m(target, suite.base) for target in targets]
        wanted = LEVELS[:, None] + PHOTOGRAPHS_PER_LOG_HEIGHT * np.log(heights_m)
        at = np.minimum(np.searchsorted(numbers, wanted), len(numbers) - 1)
    elif name.endswith(STOPPED):
        reached = told[None] >= THRESHOLDS_PERCENT[:, None, None]  # (K, N, R)
        at = np.where(reached.any(axis=1), reached.argmax(axis=1), len(numbers) - 1)
    else:
        return Series(name, taken, scores, failed)
    return Series(name, taken[at, columns], scores[at, columns], failed)


def _curve(trial: Trial, numbers: Ints) -> Floats:
    """(2, N) F-scores and their predictions; 0 before there is a model, and where the mission failed."""
    steps = np.array(trial.metrics.get("curve") or [[np.inf, 0.0, 0.0]], dtype=float).reshape(-1, 3)
    last = np.searchsorted(steps[:, 0], numbers, side="right") - 1
    return np.where(last >= 0, steps[np.maximum(last, 0), 1:].T, 0.0)


def _end(trial: Trial, number: int) -> tuple[float, float]:
    """Photographs taken, as many as were asked for where the mission failed, and the F-score."""
    found = trial.value("registered.observable.f_score_48mm")
    score = found if found is not None else trial.value("observable.f_score_48mm")
    return trial.value("costs.images") or float(number), score or 0.0


def _believed_height_m(target: str, config: MissionConfig) -> float:
    """What a vehicle is told before it flies."""
    if is_photographed(target):
        return PhotographSet.read(target).height_m
    return 2.0 * with_size_error(config, load_coarse_rock(target, Store()), 0).target_m[2]


@dataclass(frozen=True)
class Finding:
    """What one strategy needs for the share, against the reference."""

    name: str
    needed: float | None  # mean photographs; None: the share is not reached
    ratio: Interval  # with its 95 % interval, paired over targets
    reached: float  # the largest share


def interval_text(values: Interval, form: str = ".2f") -> str:
    """``0.93 [0.89, 0.97]``; without an interval the mean alone, and nothing of nothing."""
    mean, low, high = values
    if mean is None or low is None or high is None:
        return "" if mean is None else f"{mean:{form}}"
    return f"{mean:{form}} [{low:{form}}, {high:{form}}]"


def at_share(series: Sequence[Series], reference: Series, share: float, score: float) -> list[Finding]:
    """Return how many photographs each strategy needs until ``share`` of the targets have ``score``.

    In a draw of the bootstrap in which a strategy does not reach the share, its most photographs count.
    """
    count = reference.scores.shape[1]
    everyone = np.arange(count)
    draws = np.random.default_rng(0).integers(0, count, (BOOTSTRAP, count))

    def photographs(one: Series, of: Ints) -> float:
        found = one.needed(share, score, of)
        return float(one.mean_photographs(of).max()) if found is None else found

    theirs = np.array([photographs(reference, draw) for draw in draws])
    base = reference.needed(share, score, everyone)
    findings = []
    for one in series:
        needed = one.needed(share, score, everyone)
        reached = float((one.scores >= score).mean(axis=1).max())
        ratio: Interval = (None, None, None)
        if needed is not None and base is not None:
            own = np.array([photographs(one, draw) for draw in draws])
            bounds = np.percentile(own / theirs, [2.5, 97.5]) if count >= LEAST_TARGETS else (None, None)
            ratio = (needed / base, *bounds)
        findings.append(Finding(one.name, needed, ratio, reached))
    return findings


def share_compared(reference: Series, share: float, score: float) -> float:
    """The share that is asked for; where the reference never has it, the largest whole twentieth that it does."""
    reached = float((reference.scores >= score).mean(axis=1).max())
    return share if reached >= share - 1e-9 else math.floor(20.0 * reached + 1e-9) / 20.0


def verdict(findings: Sequence[Finding], reference: str, asked: float, share: float, score: float) -> str:
    """Return the outcome in a sentence for each strategy; ``share`` as `share_compared` has it of the one ``asked`` for."""
    base = next(finding for finding in findings if finding.name == reference)
    most = (
        f"{reference} brings at most {100 * base.reached:.0f} % of the targets to an F-score of {score:g} %"
    )
    if share == 0.0 or base.needed is None:
        return (
            f"{most}: nothing can be compared with it; ask for a smaller --score, or name another --against."
        )
    said = []
    if share < asked:
        said.append(f"{most}, not the {100 * asked:g} % asked for; {100 * share:g} % are compared instead.")
    said.append(
        f"{reference} needs {base.needed:.1f} photographs for {100 * share:g} % of the targets to reach an F-score of {score:g} %."
    )
    for f in findings:
        ratio, low, high = f.ratio
        if ratio is None:
            said.append(f"{f.name} never does so: it brings at most {100 * f.reached:.0f} % of them there.")
        elif f.name != reference:
            shown = "too few targets for an interval"
            if low is not None and high is not None:
                shown = "fewer" if high < 1.0 else "more" if low > 1.0 else "no difference is shown"
            needs = f"{f.name} needs {interval_text(f.ratio)} times as many photographs as {reference}"
            said.append(f"{needs}: {shown}.")
    return " ".join(said)


def mean_interval(values: Floats) -> Interval:
    """Return the mean of (R,) values and its 95 % bootstrap interval over targets."""
    if len(values) < LEAST_TARGETS:
        return float(values.mean()), None, None
    draws = np.random.default_rng(0).integers(0, len(values), (BOOTSTRAP, len(values)))
    low, high = np.percentile(values[draws].mean(axis=1), [2.5, 97.5])
    return float(values.mean()), float(low), float(high)


def at_number(series: Sequence[Series], reference: Series, number: int, score: float) -> list[dict[str, Any]]:
    """Return each strategy at an equal mean number of photographs: F-score, what it gains on the reference, share at ``score``."""
    theirs, rows = reference.at(number, reference.scores), []
    for one in series:
        scores = one.at(number, one.scores)
        reached = one.at(number, (one.scores >= score).astype(float))
        rows.append(
            {
                "strategy": one.name,
                "photographs": number,
                "f_score": mean_interval(scores),
                "gain": mean_interval(scores - theirs),
                "share": float(reached.mean()),
                "failed": one.failed,
            }
        )
    return rows
