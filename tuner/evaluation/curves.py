"""Quality over the number of photographs, for any strategies on the same targets, and what follows from it.

A planned strategy runs once, to the largest number, and is read at every number; an orbit is a plan of its own for each. Where
photographs are rendered or given, every number is a mission of its own for all strategies.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import stats

from nbv.cache import Store, digest
from nbv.config import MissionConfig, preset
from nbv.errors import UserError
from nbv.mission.target_prior import with_size_error
from nbv.photographs import PhotographSet
from nbv.plugins import INTERFACE
from nbv.rocks import load_coarse_rock
from nbv.rocks.catalogue import is_photographed
from nbv.rocks.families import FAMILIES, HELD_OUT_FROM, SHAPES, generated_recipe
from nbv.types import Bools, Floats, Ints
from tuner.evaluation.plan import EvaluationPlan
from tuner.missions.job import Trial
from tuner.missions.registry import EXTERNAL, PHOTOGRAPHS
from tuner.problem.baselines import PLAN, baseline, ending_at, sees_ground_truth, with_sections_of

BY_HEIGHT, STOPPED = "orbit-by-height", "-stopped"  # derived from the missions of others
TWO_RINGS = "orbit-two"
PHOTOGRAPHS_PER_LOG_HEIGHT = 20.0  # more on a rock 2.7 times as high (docs/results/where_planning_pays.md)
LEVELS = np.arange(6.0, 49.0)  # photographs of a rock 1 m high
THRESHOLDS_PERCENT = np.arange(90.0, 99.6, 0.25)  # predicted F-scores at which a mission stops
BOOTSTRAP, LEAST_TARGETS = 1000, 5  # fewer have no interval
CURVE = "curve"
Interval = tuple[float | None, float | None, float | None]  # a mean and its bounds
NO_INTERVAL: Interval = (None, None, None)
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
    """Everything that decides a comparison but its strategies: publications that name the same suite ran the same missions."""

    targets: tuple[str, ...]
    numbers: tuple[int, ...] = tuple(range(12, 49, 2))
    replicates: int = 1
    score: float = 98.0  # F-score at 48 mm that a target shall reach, in percent
    share: float = 0.75  # of the targets that shall reach it
    fidelity: str = CURVE
    values: Mapping[str, Any] = field(default_factory=lambda: dict(BASE))

    def __post_init__(self) -> None:
        if list(self.numbers) != sorted(set(self.numbers)) or not self.numbers:
            raise UserError(
                f"numbers of photographs must rise, as in 12:48:2 or 16,24,32; these are {list(self.numbers)}"
            )
        if self.numbers[0] < self.base.seed.total:
            raise UserError(
                f"the first number is {self.numbers[0]}, below the {self.base.seed.total} seeds; begin there or later"
            )
        if self.fidelity in (EXTERNAL, PHOTOGRAPHS):
            raise UserError(f"compare cannot run fidelity {self.fidelity}; leave --fidelity out")
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
        named = (name for name, suite in SUITES.items() if suite == self)
        return next(named, f"custom-{digest(self.to_dict())[:8]}")

    def to_dict(self) -> dict[str, Any]:
        """JSON form."""
        return {**dataclasses.asdict(self), "interface": INTERFACE}


def drawn_targets(count: int, families: Sequence[str] = tuple(FAMILIES)) -> tuple[str, ...]:
    """Return the first ``count`` held-out rocks of the families, in turn; `UserError` where a family does not exist."""
    for family in families:
        generated_recipe(family, HELD_OUT_FROM)
    names = [f"{family}-{HELD_OUT_FROM + k}" for k in range(count) for family in families]
    return tuple(names[:count])


SUITES = {"rocks-1": Suite(drawn_targets(60)), "shapes-1": Suite(drawn_targets(50, tuple(SHAPES)))}


def require_room(targets: Sequence[str], config: MissionConfig) -> None:
    """Raise `UserError` where a target extends to the viewpoints around it."""
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
    base, configs = suite.base, dict[str, MissionConfig]()
    for name, given in strategies.items():
        source, most = _strategy_run(name), ending_at(base, suite.numbers[-1])
        if given is None:
            own = baseline(source, (BY_HEIGHT,))
        planned = own.config(most) if given is None else with_sections_of(given, PLAN, base)
        measured_throughout = bool(planned.adaptive_budget) and suite.measures_every_photograph
        if name.endswith(STOPPED) and not measured_throughout:
            raise UserError(
                f"{name}: only a planned strategy in geometric missions can stop by its prediction"
            )
        least, seeds = suite.numbers[-1 if measured_throughout else 0], planned.seed.total
        if planned.adaptive_budget and seeds > least:
            raise UserError(
                f"{name} begins with {seeds} seeds, which --numbers must allow: {least} are too few"
            )
        if measured_throughout:
            configs[source] = ending_at(planned, suite.numbers[-1])
            continue
        for n in suite.numbers:
            if planned.adaptive_budget:
                config = ending_at(planned, n)
            elif given is None:
                config = own.orbit(base, n)
            else:
                config = planned.with_values({"seed.count": n})
            configs[f"{source}-{n}"] = config
    return EvaluationPlan(configs, suite.targets, suite.replicates, fidelity=suite.fidelity)


def _strategy_run(name: str) -> str:
    """The strategy whose missions are read for the one called ``name``."""
    return TWO_RINGS if name == BY_HEIGHT else name.removesuffix(STOPPED)


@dataclass(frozen=True)
class Series:
    """A strategy at each of its K settings, a number, a level or a threshold, on R targets."""

    name: str
    photographs: Floats  # (K, R)
    scores: Floats  # (K, R) F-score at 48 mm in percent; 0 without a model, and where the mission failed
    failed: tuple[Trial, ...] = ()

    @property
    def sees_ground_truth(self) -> bool:
        """Whether it is an upper reference, no planner."""
        return sees_ground_truth(self.name.removesuffix(STOPPED))

    def mean_photographs(self, of: Ints) -> Floats:
        """(K,) means over the targets ``of``."""
        mean: Floats = self.photographs[:, of].mean(axis=1)
        return mean

    def needed(self, share: float, score: float, of: Ints) -> float | None:
        """Mean photographs of the first setting with which ``share`` of the targets reach ``score``; None: no setting does.

        Nor is a share of nothing ever reached.
        """
        reached: Bools = (self.scores[:, of] >= score).mean(axis=1) >= share - 1e-9
        return float(self.mean_photographs(of)[np.argmax(reached)]) if share and reached.any() else None

    def at(self, number: float, values: Floats) -> Floats:
        """(R,) of ``values`` (K, R) at a mean ``number`` of photographs, between settings in proportion; NaN beyond them."""
        mean = self.mean_photographs(np.arange(values.shape[1]))
        return np.array([np.interp(number, mean, own, left=np.nan, right=np.nan) for own in values.T])


def all_series(suite: Suite, strategies: Sequence[str], trials: Sequence[Trial]) -> list[Series]:
    """Return the series of the strategies from finished missions, of which every target must have some."""
    of: dict[str, dict[str, list[Trial]]] = {}
    for trial in trials:
        of.setdefault(trial.strategy, {}).setdefault(trial.rock, []).append(trial)
    return [_series(suite, name, of) for name in strategies]


def _series(suite: Suite, name: str, of: Mapping[str, Mapping[str, list[Trial]]]) -> Series:
    source, numbers, targets = _strategy_run(name), np.array(suite.numbers), suite.targets
    missions_at = [of[source] if source in of else of[f"{source}-{n}"] for n in suite.numbers]
    read = [
        [np.mean([_read(t, n) for t in missions[r]], axis=0) for r in targets]
        for n, missions in zip(suite.numbers, missions_at)
    ]
    taken, scores, predicted = np.moveaxis(np.array(read, dtype=float), -1, 0)  # (N, R) each
    ended = missions_at[:1] if source in of else missions_at
    failed = tuple(t for missions in ended for own in missions.values() for t in own if t.status == "failed")
    if name == BY_HEIGHT:
        heights_m = [_believed_height_m(target, suite.base) for target in targets]
        wanted = LEVELS[:, None] + PHOTOGRAPHS_PER_LOG_HEIGHT * np.log(heights_m)
        at = np.minimum(np.searchsorted(numbers, wanted), len(numbers) - 1)
    elif name.endswith(STOPPED):
        reached = predicted[None] >= THRESHOLDS_PERCENT[:, None, None]  # (K, N, R)
        at = np.where(reached.any(axis=1), reached.argmax(axis=1), len(numbers) - 1)
    else:
        at = np.repeat(np.arange(len(numbers))[:, None], len(targets), axis=1)
    columns = np.arange(len(targets))
    return Series(name, taken[at, columns], scores[at, columns], failed)


def _read(trial: Trial, number: int) -> tuple[float, float, float]:
    """Photographs, F-score and its prediction in percent with at most ``number``; 0 without a model, and where the mission failed."""
    if curve := trial.metrics.get("curve"):
        _, score, predicted = max((step for step in curve if step[0] <= number), default=(0, 0.0, 0.0))
        return number, score, predicted
    found = trial.value("registered.observable.f_score_48mm")
    score = found if found is not None else trial.value("observable.f_score_48mm")
    return trial.value("costs.images") or float(number), score or 0.0, 0.0


def what_scores_0(series: Sequence[Series], targets: Sequence[str]) -> list[str]:
    """Return a sentence for each cause: missions that failed, and targets of which a strategy had no model yet."""
    said = []
    for one in series:
        of_reason: dict[str, list[Trial]] = {}
        for trial in one.failed:
            of_reason.setdefault(trial.reason, []).append(trial)
        for reason, failed in of_reason.items():
            of = _named([trial.rock for trial in failed], targets)
            first = f"{failed[0].strategy} on {failed[0].rock}: {failed[0].message}"
            missions = f"{len(failed)} mission{'s' if len(failed) > 1 else ''}"
            said.append(f"{_strategy_run(one.name)}: {missions} failed ({reason}) on {of}; {first}.")
        lacking = (one.scores == 0.0) & ~np.isin(targets, [trial.rock for trial in one.failed])
        if lacking.any():
            of = _named([target for target, own in zip(targets, lacking.T) if own.any()], targets)
            numbers = one.photographs[lacking]
            span = " to ".join(dict.fromkeys(f"{n:g}" for n in (numbers.min(), numbers.max())))
            said.append(f"{one.name}: no model yet with {span} photographs on {of}.")
    return list(dict.fromkeys(said))


def _named(some: Sequence[str], targets: Sequence[str]) -> str:
    names = dict.fromkeys(some)
    return f"all {len(names)} targets" if len(names) == len(targets) > 1 else ", ".join(names)


def _believed_height_m(target: str, config: MissionConfig) -> float:
    """The height of the target that a mission is given, with its error."""
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
    fewest: bool  # whether its first setting does, so that it may need fewer


def interval_text(values: Interval, form: str = ".2f") -> str:
    """``0.93 [0.89, 0.97]``; without an interval the mean alone, and nothing of nothing."""
    mean, low, high = values
    if mean is None or low is None or high is None:
        return "" if mean is None else f"{mean:{form}}"
    return f"{mean:{form}} [{low:{form}}, {high:{form}}]"


def bounds(statistic: Callable[..., Any], values: Any, **how: Any) -> tuple[Any, Any]:
    """95 % bootstrap interval of a statistic over targets, the last axis of ``values`` (..., R); None, None for too few."""
    if values.shape[-1] < LEAST_TARGETS:
        return None, None
    same_draws = {"n_resamples": BOOTSTRAP, "rng": np.random.default_rng(0)}
    found = stats.bootstrap((values,), statistic, axis=-1, method="percentile", **same_draws, **how)
    return found.confidence_interval.low, found.confidence_interval.high


def mean_interval(values: Floats) -> Interval:
    """Return the mean of (R,) values and its interval."""
    return (float(values.mean()), *bounds(np.mean, values))


def at_share(series: Sequence[Series], reference: Series, share: float, score: float) -> list[Finding]:
    """Return how many photographs each strategy needs until ``share`` of the targets have ``score``.

    In a draw of the bootstrap in which a strategy does not reach the share, its most photographs count.
    """
    everyone = np.arange(reference.scores.shape[1])
    base = reference.needed(share, score, everyone)

    def photographs(one: Series, of: Ints) -> float:
        found = one.needed(share, score, of)
        return float(one.mean_photographs(of).max()) if found is None else found

    def finding(one: Series) -> Finding:
        needed, ratio = one.needed(share, score, everyone), NO_INTERVAL
        if needed is not None and base is not None:
            drawn = bounds(
                lambda of: photographs(one, of) / photographs(reference, of), everyone, vectorized=False
            )
            ratio = (needed / base, *drawn)
        reached = (one.scores >= score).mean(axis=1)
        return Finding(one.name, needed, ratio, float(reached.max()), bool(reached[0] >= share - 1e-9))

    return [finding(one) for one in series]


def share_compared(reference: Series, share: float, score: float) -> float:
    """The share that is asked for or, where the reference never reaches it, the largest multiple of 5 % that it reaches."""
    reached = float((reference.scores >= score).mean(axis=1).max())
    return share if reached >= share - 1e-9 else math.floor(20.0 * reached + 1e-9) / 20.0


def verdict(
    findings: Sequence[Finding], reference: str, asked: float, share: float, score: float
) -> list[str]:
    """Return the outcome in a sentence for each strategy; ``share`` as `share_compared` has it of the one ``asked`` for."""
    base = next(finding for finding in findings if finding.name == reference)
    most = (
        f"{reference} brings at most {100 * base.reached:.0f} % of the targets to an F-score of {score:g} %"
    )
    if base.needed is None:
        nothing = f"{most}: nothing can be compared with it"
        return [f"{nothing}; ask for a smaller --score, or name another --against."]
    said = []
    if share < asked:
        said.append(f"{most}, not the {100 * asked:g} % asked for; {100 * share:g} % are compared instead.")
    said.append(
        f"{reference} needs {'at most ' if base.fewest else ''}{base.needed:.1f} photographs for {100 * share:g} % of the targets to reach an "
        f"F-score of {score:g} %."
    )
    if base.fewest:
        said.append(
            "It was not tried with fewer; ask for a higher --score, or begin --numbers with a smaller one."
        )
    for f in findings:
        ratio, low, high = f.ratio
        if ratio is None:
            said.append(f"{f.name} never does so: it brings at most {100 * f.reached:.0f} % of them there.")
        elif f.name != reference:
            shown = "too few targets for an interval"
            if low is not None and high is not None:
                shown = "no difference is shown"
                if high < 1.0 and not base.fewest:
                    shown = "fewer"
                elif low > 1.0 and not f.fewest:
                    shown = "more"
            times = f"{'at most ' if f.fewest else ''}{interval_text(f.ratio)}"
            said.append(f"{f.name} needs {times} times as many photographs as {reference}: {shown}.")
    return said


def at_number(series: Sequence[Series], reference: Series, number: int, score: float) -> list[dict[str, Any]]:
    """Return each strategy at an equal mean number of photographs: F-score, what it gains on the reference, share at ``score``.

    Without strategies none of whose settings takes so few, or so many; without gains where the reference is one of these.
    """
    theirs, rows = reference.at(number, reference.scores), []
    for one in series:
        scores = one.at(number, one.scores)
        if np.isnan(scores).any():
            continue
        rows.append(
            {
                "strategy": one.name,
                "photographs": number,
                "f_score": mean_interval(scores),
                "gain": NO_INTERVAL if np.isnan(theirs).any() else mean_interval(scores - theirs),
                "share": float(one.at(number, (one.scores >= score).astype(float)).mean()),
                "failed": len(one.failed),
                "score_0": int((scores == 0.0).sum()),
            }
        )
    return rows
