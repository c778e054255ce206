"""Does the objective tell configurations apart? Configurations x rocks x replicates, at several budgets.

The run directory::

    noise_study.yaml   what was asked for; the same command with the same settings goes on
    crossed/           every configuration and control on every rock with every replicate
    repeats/           further replicates of the default configuration
    noise.json  noise.md  figures/

Fusion strictness costs no flight: each mission is measured at all levels (``nbv.photogrammetric.agreement_levels``).
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from scipy.stats import qmc

from nbv.config import MissionConfig, preset
from nbv.errors import UserError
from nbv.photogrammetric.agreement_levels import AGREEMENT_LEVELS
from nbv.types import Floats
from tuner.evaluation.baselines import baseline
from tuner.evaluation.flying import failure_counts
from tuner.evaluation.plan import EvaluationPlan, EvaluationRecord
from tuner.problem.search_space import SearchSpace
from tuner.problem.space_files import space_from_dict
from tuner.studies.noise.variance import (
    MIN_CONFIGURATIONS,
    VarianceComponents,
    largest_complete,
    pooled_variance,
    variance_components,
)
from tuner.studies.study_directory import StudySettings, flown

DEFAULT = "default"
DEFAULT_METRICS = (
    "observable.f_score_48mm",
    "observable.completeness_48mm",
    "observable.f_score_16mm",
    "observable.f_score_auc",
    "whole.f_score_48mm",
    "observable.c2c_mean_mm",
    "observable.c2c_p95_mm",
    "observable.hausdorff_gt_to_cloud_mm",
)
TARGET_SIGNAL_TO_NOISE = 5.0  # asked of the campaign preset


@dataclass(frozen=True)
class NoiseSettings(StudySettings):
    """What a noise study flies.

    Raises
    ------
    UserError
        Too few configurations or replicates for a variance, an unknown control, no rock.
    """

    FILE: ClassVar[str] = "noise_study.yaml"
    STUDY: ClassVar[str] = "noise study"
    space: SearchSpace
    rocks: tuple[str, ...]
    budgets: tuple[int, ...] = (8, 12, 16, 40)  # adaptive captures
    configurations: int = 16  # Sobol points of the space
    replicates: int = 3  # of every configuration on every rock
    repeats: int = 5  # further replicates of the default configuration
    controls: tuple[str, ...] = ("learned", "random", "greedy-oracle")
    metrics: tuple[str, ...] = DEFAULT_METRICS
    levels: tuple[int, ...] = AGREEMENT_LEVELS  # dense.agreeing_views that are reported
    seed: int = 0
    preset: str = "campaign"
    overrides: dict[str, Any] = field(default_factory=dict)
    fidelity: str = "several-agreement-levels"

    def __post_init__(self) -> None:
        if self.configurations < MIN_CONFIGURATIONS:
            raise UserError(
                f"configurations is {self.configurations}; give at least {MIN_CONFIGURATIONS}, better 12 or more"
            )
        if self.replicates < 2:
            raise UserError(f"replicates is {self.replicates}; a replicate variance needs at least 2")
        if self.repeats < 0:
            raise UserError(f"repeats is {self.repeats}; give 0 or more")
        if not self.budgets or len(set(self.budgets)) != len(self.budgets):
            raise UserError(f"budgets are {list(self.budgets)}; name each adaptive budget once")
        if not self.levels or not set(self.levels) <= set(AGREEMENT_LEVELS):
            raise UserError(f"levels are {list(self.levels)}; choose from {list(AGREEMENT_LEVELS)}")
        if not self.metrics:
            raise UserError("no metric to study; name at least one")
        for name in self.controls:
            baseline(name)
        if "dense.agreeing_views" in self.overrides:
            raise UserError("dense.agreeing_views cannot be set here: the study measures all its levels")
        self.configs(self.budgets[0])

    def base(self, budget: int) -> MissionConfig:
        """What all configurations have in common."""
        values = {
            **self.overrides,
            "stop.adaptive_budget": budget,
            "dense.agreeing_views": min(self.levels),
        }
        return self.space.base_config(preset(self.preset).with_values(values))

    @functools.cached_property
    def points(self) -> dict[str, dict[str, Any]]:
        """Tuned values of the default and of every Sobol point, by name."""
        engine = qmc.Sobol(self.space.dimension, scramble=True, rng=self.seed)
        unit = engine.random_base2(math.ceil(math.log2(self.configurations)))[: self.configurations]
        points = {f"sobol-{i:02d}": self.space.from_unit(u) for i, u in enumerate(unit)}
        return {DEFAULT: self.space.default(self.base(self.budgets[0])), **points}

    def configs(self, budget: int) -> dict[str, MissionConfig]:
        """Mission configurations by name at one adaptive budget: default, Sobol points, controls."""
        base = self.base(budget)
        return {
            **{name: base.with_values(values) for name, values in self.points.items()},
            **{name: baseline(name).config(base) for name in self.controls},
        }

    def crossed_plan(self) -> EvaluationPlan:
        """Return the crossed design: every configuration on every rock with every replicate."""
        strategies = {
            strategy_name(budget, name): config
            for budget in self.budgets
            for name, config in self.configs(budget).items()
        }
        return EvaluationPlan(strategies, self.rocks, self.replicates, fidelity=self.fidelity)

    def repeats_plan(self) -> EvaluationPlan | None:
        """The default configuration, with replicates that the crossed design does not hold."""
        if self.repeats == 0:
            return None
        strategies = {strategy_name(b, DEFAULT): self.configs(b)[DEFAULT] for b in self.budgets}
        return EvaluationPlan(
            strategies, self.rocks, self.repeats, first_replicate=self.replicates, fidelity=self.fidelity
        )

    def plans(self) -> dict[str, EvaluationPlan]:
        """Everything against everything, then the repeats."""
        repeats = self.repeats_plan()
        return {"crossed": self.crossed_plan(), **({"repeats": repeats} if repeats else {})}

    def to_dict(self) -> dict[str, Any]:
        """YAML form."""
        tree = super().to_dict()
        return {"search_space": tree.pop("space").to_dict(), **tree}

    @classmethod
    def from_dict(cls, tree: dict[str, Any], source: str) -> Self:
        """The inverse of ``to_dict``."""
        space = space_from_dict(tree.pop("search_space"), source)
        return super().from_dict({**tree, "space": space}, source)


def strategy_name(budget: int, name: str) -> str:
    """The strategy under which one configuration flies at one budget."""
    return f"b{budget:02d}-{name}"


# -- what the missions say -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class NoiseCell:
    """One metric at one adaptive budget and one fusion strictness."""

    budget: int
    agreement: int
    metric: str
    components: VarianceComponents | None  # None: too few complete configurations yet
    means: dict[
        str, float
    ]  # over rocks and replicates, by name; only of complete configurations and controls
    default_within: tuple[float, float, float, int] | None  # pooled over rocks, with interval and degrees
    missing: int  # missions of the crossed design without this metric (failed, or not flown yet)
    mission_s: float | None  # mean wall time of one mission measured at one level

    @property
    def meets_target(self) -> bool:
        """Whether configurations stand out from replicates as much as asked."""
        return self.components is not None and self.components.signal_to_noise >= TARGET_SIGNAL_TO_NOISE

    def to_dict(self) -> dict[str, Any]:
        """JSON form with the derived figures."""
        tree: dict[str, Any] = {
            name: getattr(self, name) for name in ("budget", "agreement", "metric", "missing", "mission_s")
        }
        if (c := self.components) is not None:
            low, high = c.signal_to_noise_interval()
            tree["components"] = dataclasses.asdict(c)
            tree |= {
                "between": c.between,
                "noise": c.noise,
                "signal_to_noise": c.signal_to_noise,
                "signal_to_noise_95": [low, high],
                "paired_signal_to_noise": c.paired_signal_to_noise,
                "unseen_signal_to_noise": c.unseen_signal_to_noise,
                "shares": c.shares(),
            }
        if self.default_within is not None:
            variance, low, high, degrees = self.default_within
            tree["default_replicate_sd"] = {
                "sd": math.sqrt(variance),
                "sd_95": [math.sqrt(low), math.sqrt(high)],
                "degrees": degrees,
            }
        return {**tree, "means": self.means}


@dataclass(frozen=True)
class NoiseFindings:
    """All cells of a study, with the missions they come from."""

    settings: NoiseSettings
    records: list[EvaluationRecord]  # crossed and repeats
    cells: list[NoiseCell]
    failures: dict[str, int]  # failed missions by reason
    expected: int  # missions the study asks for

    def cell(self, budget: int, agreement: int, metric: str) -> NoiseCell:
        """The cell of that name."""
        key = (budget, agreement, metric)
        return next(c for c in self.cells if (c.budget, c.agreement, c.metric) == key)

    def values(self, budget: int, agreement: int, metric: str) -> dict[str, Floats]:
        """(K, R) per configuration and control, NaN where a mission has no such metric."""
        table = _table(self.records, agreement, metric)
        s = self.settings
        names = [*s.points, *s.controls]
        return {
            name: np.array(
                [
                    [table.get((strategy_name(budget, name), rock, k), math.nan) for k in range(s.replicates)]
                    for rock in s.rocks
                ]
            )
            for name in names
        }

    def ranked(self, metric: str) -> list[NoiseCell]:
        """Cells of one metric, best signal to noise first."""
        known = [c for c in self.cells if c.metric == metric and c.components is not None]
        return sorted(known, key=lambda c: -c.components.signal_to_noise)  # type: ignore[union-attr]

    def to_dict(self) -> dict[str, Any]:
        """JSON form."""
        return {
            "settings": self.settings.to_dict(),
            "points": self.settings.points,
            "missions": len(self.records),
            "missions_expected": self.expected,
            "failures": self.failures,
            "target_signal_to_noise": TARGET_SIGNAL_TO_NOISE,
            "cells": [cell.to_dict() for cell in self.cells],
        }


def _table(
    records: Sequence[EvaluationRecord], agreement: int, metric: str
) -> dict[tuple[str, str, int], float]:
    """A metric at one strictness by (strategy, rock, replicate)."""
    found = {}
    for r in records:
        value = r.value(f"agreement.{agreement}.{metric}")
        if value is not None:
            found[r.strategy, r.rock, r.replicate] = value
    return found


def analyse(directory: Path) -> NoiseFindings:
    """Return what the missions of a study's directory say so far.

    Raises
    ------
    UserError
        No noise study there, or no mission has one of the metrics.
    """
    settings = NoiseSettings.load(directory)
    records = [r for found in flown(settings, directory).values() for r in found]
    ended_well = [r for r in records if r.outcome.status != "failed"]
    for metric in settings.metrics:
        if ended_well and not any(_table(ended_well, level, metric) for level in settings.levels):
            raise UserError(
                f"no mission of {directory} has the metric {metric!r}; mission.json lists them by name"
            )
    cells = [
        _cell(settings, records, _table(records, level, metric), budget, level, metric)
        for metric in settings.metrics
        for level in settings.levels
        for budget in settings.budgets
    ]
    return NoiseFindings(settings, records, cells, failure_counts(records), settings.missions)


def _cell(
    settings: NoiseSettings,
    records: Sequence[EvaluationRecord],
    table: Mapping[tuple[str, str, int], float],
    budget: int,
    agreement: int,
    metric: str,
) -> NoiseCell:
    def of(name: str, replicates: range) -> Floats:
        strategy = strategy_name(budget, name)
        return np.array(
            [[table.get((strategy, rock, k), math.nan) for k in replicates] for rock in settings.rocks]
        )

    crossed = range(settings.replicates)
    names = [name for name in settings.points if name != DEFAULT]
    design = np.array([of(name, crossed) for name in names])  # (C, K, R)
    complete, _, _ = largest_complete(design)
    references = [DEFAULT, *settings.controls]
    means = {name: float(of(name, crossed).mean()) for name in [*names, *references]}
    default = of(DEFAULT, range(settings.replicates + settings.repeats))
    walls = [
        r.outcome.wall_s - float(r.outcome.timings_s.get("agreement_levels", 0.0))
        for r in records
        if r.strategy.startswith(strategy_name(budget, "")) and r.outcome.status != "failed"
    ]
    return NoiseCell(
        budget,
        agreement,
        metric,
        variance_components(complete) if len(complete) else None,
        {name: mean for name, mean in means.items() if math.isfinite(mean)},
        pooled_variance([row[np.isfinite(row)] for row in default]),
        int(np.isnan(design).sum()),
        float(np.mean(walls)) if walls else None,
    )
