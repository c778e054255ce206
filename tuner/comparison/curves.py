"""Quality over the number of photographs, for any strategies on the same targets, and what follows from it.

A planned strategy runs once, to the largest number, and is read at every number; an orbit is a plan of its own for each. Where
photographs are rendered or given, every number is a mission of its own for all strategies.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nbv.cache import Store, digest
from nbv.config import IDEAL_CONDITION, Condition, MissionConfig, preset, require_distinct, under
from nbv.errors import UserError
from nbv.mission.target_prior import with_size_error
from nbv.photographs import PhotographSet
from nbv.plugins import INTERFACE
from nbv.rocks import load_coarse_rock
from nbv.rocks.families import FAMILIES, HELD_OUT_FROM, generated_name, generated_recipe
from nbv.types import Bools, Floats, Ints
from tuner.comparison.plan import EvaluationPlan
from tuner.comparison.statistics import Verdict, kind_of
from tuner.missions.job import Trial
from tuner.missions.registry import kind_on, mission_kind
from tuner.problem.baselines import PLAN, baseline, ending_at, is_orbit, sees_ground_truth, with_sections_of
from tuner.problem.instances import Instance
from tuner.problem.intervals import Interval, bootstrap_bounds, bootstrap_means, bootstrapped

BY_HEIGHT, STOPPED = "orbit-by-height", "-stopped"  # derived from the missions of others
TWO_RINGS, CEILING = "orbit-two", "greedy-oracle"
LITTLE = 1.0  # points: what the oracle gains at most where it is not worth trying planners
PHOTOGRAPHS_PER_LOG_HEIGHT = 20.0  # more on a rock 2.7 times as high (docs/results/where_planning_pays.md)
LEVELS = np.arange(6.0, 49.0)  # photographs of a rock 1 m high
THRESHOLDS_PERCENT = np.arange(90.0, 99.6, 0.25)  # predicted F-scores at which a mission stops
SHOWN_NUMBERS = (16, 20, 24, 32, 40)  # beside the first and the last
CURVE = "curve"
DECIDED = ("gate.kind", "photographs")
# Seeds as few as register, the size of targets known to 20 %, and no weights but its main term for a built-in scorer.
BASE: dict[str, Any] = {
    "dense.agreeing_views": 3,
    "sparse.ground_features": 2000,
    "sparse.min_registered_seeds": 6,
    "seeds": 12,
    "seed.layout": "turn",
    "seed.radius_m": 3.5,
    "seed.lowest_deg": 10.0,
    "stop.criterion": "budget",
    "gate.oracle_samples": 3000,
}


@dataclass(frozen=True)
class Suite:
    """Everything that decides a comparison but its strategies: publications that name the same suite ran the same missions."""

    targets: tuple[Instance, ...]
    numbers: tuple[int, ...] = tuple(range(12, 49, 2))
    replicates: int = 1
    score: float = 98.0  # F-score at 48 mm that a target shall reach, in percent
    share: float = 0.75  # of the targets that shall reach it
    fidelity: str = CURVE
    values: Mapping[str, Any] = field(default_factory=lambda: dict(BASE))
    conditions: tuple[Condition, ...] = (IDEAL_CONDITION,)  # those of the targets

    def __post_init__(self) -> None:
        if list(self.numbers) != sorted(set(self.numbers)) or not self.numbers:
            raise UserError(
                f"numbers of photographs must rise, as in 12:48:2 or 16,24,32; these are {list(self.numbers)}"
            )
        if self.numbers[0] < self.base.seeds:
            raise UserError(
                f"the first number is {self.numbers[0]}, below the {self.base.seeds} seeds; begin there or later"
            )
        if mission_kind(self.fidelity).targets not in ("rocks", "own"):
            raise UserError(f"compare cannot run fidelity {self.fidelity}; leave --fidelity out")
        require_distinct(self.conditions)
        if not 0.0 < self.share <= 1.0 or not 0.0 < self.score <= 100.0:
            raise UserError(f"share {self.share:g} must be in (0, 1] and score {self.score:g} in (0, 100]")
        for path in self.values:
            if path in DECIDED:
                raise UserError(f"{path} is decided by --strategy and --numbers; leave it out")
            for condition in self.conditions:
                if any(p == path or p.startswith(f"{path}.") for p in condition.paths):
                    raise UserError(
                        f"{path} is set by condition {condition.name!r} and by --set; leave one out"
                    )

    @property
    def base(self) -> MissionConfig:
        return preset("campaign").with_values(dict(self.values))

    @property
    def name(self) -> str:
        """A published name, or one made of the content."""
        named = (name for name, suite in SUITES.items() if suite == self)
        return next(named, f"custom-{digest(self.to_dict())[:8]}")

    def to_dict(self) -> dict[str, Any]:
        return {**dataclasses.asdict(self), "interface": INTERFACE}


def drawn_targets(count: int, families: Sequence[str] = tuple(FAMILIES)) -> tuple[Instance, ...]:
    """Return the first ``count`` held-out rocks of the families, in turn; `UserError` where a family does not exist."""
    for family in families:
        generated_recipe(family, HELD_OUT_FROM)
    names = [f"{family}-{HELD_OUT_FROM + k}" for k in range(count) for family in families]
    return tuple(map(Instance, names[:count]))


SUITES = {"rocks-1": Suite(drawn_targets(60))}


def leaves_room(ceiling: Interval | None) -> bool:
    """Return whether the oracle was run and gains so much on average that a planner may gain some of it."""
    return ceiling is not None and ceiling.mean > LITTLE


def require_room(suite: Suite) -> None:
    """Raise `UserError` where a target extends to the viewpoints around it."""
    config = suite.base
    for rock in dict.fromkeys(target.rock for target in suite.targets):
        if kind_on(rock, suite.fidelity).photographs == "taken":
            continue
        vertices_m = load_coarse_rock(rock, Store()).vertices_m
        reach_m = float(np.linalg.norm(vertices_m[:, :2], axis=1).max())
        if reach_m >= min(config.pool.radius_m, config.seed.radius_m):
            raise UserError(
                f"{rock} reaches {reach_m:.1f} m from its middle, and views stand {config.pool.radius_m:g} m from it; "
                "set pool.radius_m and seed.radius_m to more"
            )


def comparison_plan(suite: Suite, strategies: Mapping[str, MissionConfig | None]) -> EvaluationPlan:
    """Return the missions of a suite; ``strategies`` by name, None for the baseline, scorer or gate of that name.

    Of a configuration its plan is taken, and photographs are reconstructed and measured as those of all others are.

    Raises `UserError`: there is no such strategy, or nothing can stop it.
    """
    configs: dict[str, MissionConfig] = {}
    for name, given in strategies.items():
        configs |= _missions_of(suite, name, given)
    rocks = tuple(dict.fromkeys(target.rock for target in suite.targets))
    return EvaluationPlan(
        configs, rocks, suite.replicates, fidelity=suite.fidelity, conditions=suite.conditions
    )


def _missions_of(suite: Suite, name: str, given: MissionConfig | None) -> dict[str, MissionConfig]:
    base, source = suite.base, _strategy_run(name)
    if given is None:
        strategy = baseline(source, (BY_HEIGHT,))
        planned = strategy.config(ending_at(base, suite.numbers[-1]))
    else:
        planned = with_sections_of(given, PLAN, base)
    measured_throughout = bool(planned.planned_views) and all(
        kind_on(target.rock, suite.fidelity).every_number for target in suite.targets
    )
    if name.endswith(STOPPED) and not measured_throughout:
        raise UserError(f"{name}: only a planned strategy in geometric missions can stop by its prediction")
    least, seeds = suite.numbers[-1 if measured_throughout else 0], planned.seeds
    if planned.planned_views and seeds > least:
        raise UserError(f"{name} begins with {seeds} seeds, which --numbers must allow: {least} are too few")
    if measured_throughout:
        return {source: ending_at(planned, suite.numbers[-1])}

    def at(n: int) -> MissionConfig:
        if planned.planned_views:
            return ending_at(planned, n)
        return (
            strategy.orbit(base, n) if given is None else planned.with_values({"photographs": n, "seeds": n})
        )

    return {f"{source}-{n}": at(n) for n in suite.numbers}


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

    def mean_photographs(self, of: Ints | slice) -> Floats:
        """(K,) means over the targets ``of``."""
        mean: Floats = self.photographs[:, of].mean(axis=1)
        return mean

    def shares(self, score: float, of: Ints | slice = slice(None)) -> Floats:
        """(K,) shares of the targets ``of`` that reach ``score``."""
        share: Floats = (self.scores[:, of] >= score).mean(axis=1)
        return share

    def needed(self, share: float, score: float, of: Ints) -> float | None:
        """Mean photographs of the first setting with which ``share`` of the targets reach ``score``; None: no setting does.

        Nor is a share of nothing ever reached.
        """
        reached: Bools = self.shares(score, of) >= share - 1e-9
        return float(self.mean_photographs(of)[np.argmax(reached)]) if share and reached.any() else None

    def at(self, number: float, values: Floats) -> Floats | None:
        """(R,) of ``values`` (K, R) at a mean ``number`` of photographs, between settings in proportion.

        None more than one photograph beyond them; photograph sets may lack one here and there.
        """
        mean = self.mean_photographs(slice(None))
        if not mean[0] - 1.0 < number < mean[-1] + 1.0:
            return None
        return np.array([np.interp(number, mean, column) for column in values.T])


def all_series(suite: Suite, strategies: Sequence[str], trials: Sequence[Trial]) -> list[Series]:
    """Return the series of the strategies from finished missions, of which every target must have some."""
    of: dict[str, dict[Instance, list[Trial]]] = {}
    for trial in trials:
        of.setdefault(trial.strategy, {}).setdefault(trial.instance, []).append(trial)
    return [_series(suite, name, of) for name in strategies]


def _series(suite: Suite, name: str, of: Mapping[str, Mapping[Instance, list[Trial]]]) -> Series:
    source, numbers, targets = _strategy_run(name), np.array(suite.numbers), suite.targets
    missions_at = [of[source] if source in of else of[f"{source}-{n}"] for n in suite.numbers]
    read = [
        [[_read(t, n) for t in missions[r]] for r in targets]
        for n, missions in zip(suite.numbers, missions_at)
    ]
    taken, scores, predicted = np.moveaxis(np.array(read, dtype=float), -1, 0)  # (N, R, replicates) each
    number, target, replicate = np.ogrid[: len(numbers), : len(targets), : taken.shape[2]]
    ended = missions_at[:1] if source in of else missions_at
    failed = tuple(
        t for missions in ended for trials in missions.values() for t in trials if t.record.status == "failed"
    )
    if name == BY_HEIGHT:
        wanted = LEVELS[:, None] + PHOTOGRAPHS_PER_LOG_HEIGHT * np.log(
            [_believed_height_m(suite, target) for target in targets]
        )
        at = np.minimum(np.searchsorted(numbers, wanted), len(numbers) - 1)[..., None]
    elif name.endswith(STOPPED):
        reached = predicted >= THRESHOLDS_PERCENT[:, None, None, None]  # (K, N, R, replicates)
        at = np.where(reached.any(axis=1), reached.argmax(axis=1), len(numbers) - 1)
    else:
        at = number
    _, different = np.unique(at, axis=0, return_index=True)  # levels and thresholds may choose the same
    chosen = at[np.sort(different)], target, replicate
    return Series(name, taken[chosen].mean(axis=-1), scores[chosen].mean(axis=-1), failed)


def _read(trial: Trial, number: int) -> tuple[float, float, float]:
    """Photographs, F-score and its prediction in percent with at most ``number``; 0 without a model, and where the mission failed."""
    if curve := trial.metrics.get("curve"):
        _, score, predicted = max((step for step in curve if step[0] <= number), default=(0, 0.0, 0.0))
        return number, score, predicted
    registered = trial.value("registered.observable.f_score_48mm")
    score = registered if registered is not None else trial.value("observable.f_score_48mm")
    return trial.value("costs.images") or float(number), score or 0.0, 0.0


def _believed_height_m(suite: Suite, target: Instance) -> float:
    """The height of the target that a mission is given, with its error."""
    if kind_on(target.rock, suite.fidelity).photographs == "taken":
        return PhotographSet.read(target.rock).height_m
    config = under(suite.base, next(c for c in suite.conditions if c.name == target.condition))
    return 2.0 * with_size_error(config, load_coarse_rock(target.rock, Store()), 0).target_m[2]


@dataclass(frozen=True)
class Finding:
    """What one strategy needs for the share, against the reference."""

    strategy: str
    kind: Verdict  # better: with fewer photographs; not paired: one of the two never reaches the share
    needed: float | None  # mean photographs; None: the share is not reached
    ratio: Interval | None  # paired over targets
    reached: float  # the largest share
    fewest: bool  # whether its first setting does, so that it may need fewer


@dataclass(frozen=True)
class Standing:
    """One strategy at a mean number of photographs, against the reference at that number."""

    strategy: str
    photographs: int
    kind: Verdict
    f_score: Interval
    gain: Interval | None  # None where the reference never takes so few, or so many
    share: float  # of the targets that have the score
    failed: int
    score_0: int


def at_share(series: Sequence[Series], reference: Series, share: float, score: float) -> list[Finding]:
    """Return how many photographs each strategy needs until ``share`` of the targets have ``score``.

    In a draw of the bootstrap in which a strategy does not reach the share, its most photographs count.
    """
    everyone = np.arange(reference.scores.shape[1])
    base = reference.needed(share, score, everyone)

    def fewest(one: Series) -> bool:
        return bool(share and one.shares(score)[0] >= share - 1e-9)

    def photographs(one: Series, of: Ints) -> float:
        number = one.needed(share, score, of)
        return float(one.mean_photographs(of).max()) if number is None else number

    def finding(one: Series) -> Finding:
        needed, ratio, kind = one.needed(share, score, everyone), None, Verdict.NOT_PAIRED
        if needed is not None and base is not None:
            low, high = bootstrap_bounds(
                lambda of: photographs(one, of) / photographs(reference, of), everyone, vectorized=False
            )
            ratio = bootstrapped(needed / base, low, high, len(everyone))
            if low is None:
                kind = Verdict.NO_INTERVAL
            elif high < 1.0 and not fewest(reference):  # it may need fewer than were tried
                kind = Verdict.BETTER
            else:
                kind = Verdict.WORSE if low > 1.0 and not fewest(one) else Verdict.NO_DIFFERENCE
        return Finding(one.name, kind, needed, ratio, float(one.shares(score).max()), fewest(one))

    return [finding(one) for one in series]


def at_number(series: Sequence[Series], reference: Series, number: int, score: float) -> list[Standing]:
    """Return each strategy at an equal mean number of photographs, those left out that never take so few, or so many."""
    theirs, standings = reference.at(number, reference.scores), list[Standing]()
    for one in series:
        scores, reached = (one.at(number, v) for v in (one.scores, (one.scores >= score).astype(float)))
        if scores is None or reached is None:
            continue
        gain = None if theirs is None else bootstrap_means(scores - theirs)[0]
        kind = Verdict.NOT_PAIRED if gain is None else kind_of(gain)
        figures = bootstrap_means(scores)[0], gain, float(reached.mean())
        standings.append(
            Standing(one.name, number, kind, *figures, len(one.failed), int((scores == 0.0).sum()))
        )
    return standings


@dataclass(frozen=True)
class CurvesOutcome:
    reference: str
    share: float  # at which numbers of photographs are compared; 0: the reference never reaches it
    number: int  # the largest that the reference takes
    findings: list[Finding]
    standings: list[Standing]  # number by number
    plain: str  # the best plain plan at ``number``; empty without one
    ceiling: Interval | None  # the greedy oracle minus that plan; None where one of them was not run
    ground_truth: list[str]  # strategies that see it

    @property
    def by_share(self) -> bool:
        """Whether numbers of photographs are compared; not where all ratios would be of the first. Else scores at ``number``."""
        return any(f.needed is not None and not f.fewest for f in self.findings)


def outcome(suite: Suite, series: Sequence[Series], reference: str) -> CurvesOutcome:
    """Return what the series say; ``reference``: the strategy of the ratios and gains."""
    score, base = suite.score, next(one for one in series if one.name == reference)
    share = suite.share if base.shares(score).max() >= suite.share - 1e-9 else 0.0
    findings = at_share(series, base, share, score)
    within = [n for n in suite.numbers if base.at(n, base.scores) is not None]
    number = within[-1] if within else int(base.mean_photographs(slice(None))[-1])
    shown = sorted({suite.numbers[0], number, suite.numbers[-1], *set(SHOWN_NUMBERS) & {*suite.numbers}})
    standings = [row for n in shown for row in at_number(series, base, n, score)]
    scores = {one.name: v for one in series if (v := one.at(number, one.scores)) is not None}
    plain = {n: s.mean() for n, s in scores.items() if is_orbit(n) or n in ("random", BY_HEIGHT)}
    best, ceiling = max(plain, key=lambda name: plain[name], default=""), None
    if best and CEILING in scores:
        (ceiling,) = bootstrap_means(scores[CEILING] - scores[best])
    oracles = [s.name for s in series if s.sees_ground_truth]
    return CurvesOutcome(reference, share, number, findings, standings, best, ceiling, oracles)


def panels(suite: Suite, series: Sequence[Series]) -> dict[str, list[tuple[Floats, list[Interval]]]]:
    """Mean photographs and, over them, the share in percent, the F-score of all targets ("") and of each family; by series."""
    of_family: dict[str, list[int]] = {}
    for r, target in enumerate(suite.targets):
        named = generated_name(target.rock)
        of_family.setdefault(named[0] if named else "others", []).append(r)
    reached = [np.where(one.scores >= suite.score, 100.0, 0.0) for one in series]
    everyone = np.arange(len(suite.targets))
    drawn = {"share": [(s.mean_photographs(everyone), bootstrap_means(v)) for s, v in zip(series, reached)]}
    groups = {name: np.array(of) for name, of in of_family.items() if len(of_family) > 1}
    for name, of in {"": everyone, **groups}.items():
        drawn[name] = [(s.mean_photographs(of), bootstrap_means(s.scores[:, of])) for s in series]
    return drawn
