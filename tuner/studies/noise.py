"""How noisy is a mission, and do configurations differ by more than that?

Points of a search space run every rock with every replicate. Replicate k on a rock is the same draw of arrival errors and
sensor noise for all configurations, a block nested in the rock:

    y[c, r, k] = mu + C[c] + R[r] + (CR)[c, r] + B[r, k] + e[c, r, k]

with independent, centred random effects. Estimates are the analysis of variance's (method of moments), so a variance may
come out negative, which means about zero.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table
from scipy import stats

from nbv.config import preset
from nbv.errors import UserError
from nbv.mission.result import json_ready
from nbv.safe_files import write_atomic
from nbv.types import Floats
from tuner.evaluation.plan import EvaluationPlan
from tuner.missions.job import Trial
from tuner.missions.registry import DEFAULT_FIDELITY
from tuner.problem.search_space import SearchSpace
from tuner.report.labels import format_number, metric_label
from tuner.report.terminal import whole_tables
from tuner.samplers.design import sobol_point

DEFAULT = "default"
METRICS = (
    "observable.f_score_48mm",
    "observable.completeness_48mm",
    "observable.c2c_mean_mm",
    "observable.hausdorff_gt_to_cloud_mm",
)
LEAST_CONFIGURATIONS, LEAST_REPLICATES = 3, 2
WANTED = 5.0  # signal to noise


def noise_plan(
    space: SearchSpace,
    rocks: Sequence[str],
    configurations: int = 8,
    replicates: int = 3,
    *,
    overrides: Mapping[str, Any] | None = None,
    fidelity: str = DEFAULT_FIDELITY,
) -> EvaluationPlan:
    """Return what the study runs: the default and Sobol points of the space, on every rock with every replicate.

    Parameters
    ----------
    space
        The search space whose configurations are compared.
    rocks
        Training rocks.
    configurations, replicates
        Sobol points of the space, and replicates of each on every rock.
    overrides
        Values by parameter path, laid over preset ``campaign``.
    fidelity
        Of the missions.

    Raises
    ------
    UserError
        Too few configurations or replicates for a variance; an unknown path or fidelity; no rock.
    """
    if configurations < LEAST_CONFIGURATIONS:
        raise UserError(f"configurations is {configurations}; give at least {LEAST_CONFIGURATIONS}")
    if replicates < LEAST_REPLICATES:
        raise UserError(f"replicates is {replicates}; a variance needs at least {LEAST_REPLICATES}")
    config = space.base_config(preset("campaign").with_values(dict(overrides or {})))
    points = {f"sobol-{i:02d}": sobol_point(space, 0, i) for i in range(configurations)}
    named = {DEFAULT: space.default(config), **points}
    strategies = {name: space.config(config, values) for name, values in named.items()}
    return EvaluationPlan(strategies, tuple(rocks), replicates, fidelity=fidelity)


@dataclass(frozen=True)
class Noise:
    """Variances of one metric, in the square of its unit."""

    metric: str
    default: float  # mean of the default configuration
    between: float  # between configurations, of their true mean over these rocks
    mission: float  # between replicates of one configuration on one rock
    paired: float  # the same without the draw that configurations share
    signal_to_noise: float  # ``between`` over the variance of a mean of one mission per rock, not below 0
    interval_95: tuple[float, float]  # of that ratio, by the F distribution; exact where no draw is shared
    paired_signal_to_noise: float  # where configurations are compared on common replicates
    configurations: int
    rocks: int
    replicates: int


def analyse(plan: EvaluationPlan, records: Sequence[Trial], metric: str) -> Noise | None:
    """Return what the missions so far say of ``metric``; None before enough configurations are complete."""
    value = {(r.strategy, r.rock, r.replicate): r.value(metric) for r in records}

    def of(name: str) -> list[list[float]]:
        found = [[value.get((name, rock, k)) for k in range(plan.replicates)] for rock in plan.rocks]
        return [[math.nan if y is None else y for y in row] for row in found]

    design = complete_part(np.array([of(name) for name in plan.strategies if name != DEFAULT]))
    if len(design) < LEAST_CONFIGURATIONS:
        return None
    default = [y for row in of(DEFAULT) for y in row if math.isfinite(y)]
    return noise_of(design, metric, float(np.mean(default)) if default else math.nan)


def complete_part(design: Floats) -> Floats:
    """Return the part of (C, K, R) outcomes without NaN that has the most missions: whole configurations, first replicates."""
    parts = []
    for count in range(LEAST_REPLICATES, design.shape[2] + 1):
        part = design[:, :, :count]
        parts.append(part[np.isfinite(part).all(axis=(1, 2))])
    return max(parts, key=lambda part: part.size)


def noise_of(design: Floats, metric: str = "", default: float = math.nan) -> Noise:
    """Split the variance of a complete design, (C, K, R): configurations, rocks, replicates; C and R at least 2."""
    c, k, r = design.shape
    by_cell, by_block = design.mean(axis=2), design.mean(axis=0)  # (C, K), (K, R)
    mean_square = k * r * float(design.mean(axis=(1, 2)).var(ddof=1))
    left = design - by_cell[:, :, None] - by_block[None] + by_block.mean(axis=1)[None, :, None]
    paired = float((left**2).sum()) / (k * (c - 1) * (r - 1))
    mission = float(((design - by_cell[:, :, None]) ** 2).sum()) / (c * k * (r - 1))

    def ratio(square: float, noise: float) -> float:
        signal = (square - paired) / r
        if signal <= 0:
            return 0.0
        return signal / noise if noise > 0 else math.inf

    degrees = (c - 1, c * k * (r - 1))
    low, high = (ratio(mean_square / stats.f.ppf(q, *degrees), mission) for q in (0.975, 0.025))
    return Noise(
        metric=metric,
        default=default,
        between=(mean_square - paired) / (k * r),
        mission=mission,
        paired=paired,
        signal_to_noise=ratio(mean_square, mission),
        interval_95=(low, high),
        paired_signal_to_noise=ratio(mean_square, paired),
        configurations=c,
        rocks=k,
        replicates=r,
    )


_COLUMNS = (
    *("metric", "default", "sd between configurations", "sd of a mission", "paired"),
    *("signal to noise", "95 %", "paired"),
)


def noise_tables(found: Sequence[Noise], width: int) -> Iterator[Table]:
    """For the terminal, a metric a row.

    Signal to noise: the variance between configurations of their true mean over these rocks over the variance of one
    configuration's mean, run once on each. Paired: on common replicates, as campaigns and evaluations compare; draws that
    all configurations share cancel.
    """
    rows = []
    for noise in found:
        label, (low, high) = metric_label(noise.metric), noise.interval_95
        sds = (math.sqrt(max(0.0, part)) for part in (noise.between, noise.mission, noise.paired))
        rows.append(
            (
                f"{label.full} ({label.unit})",
                format_number(noise.default),
                *(format_number(sd, 2) for sd in sds),
                format_number(noise.signal_to_noise),
                f"{format_number(low)} to {format_number(high)}",
                format_number(noise.paired_signal_to_noise),
            )
        )
    title, caption = "Do configurations differ by more than missions do?", f"wanted: {WANTED:g} or more"
    return whole_tables(_COLUMNS, rows, width, title, caption)


def write_noise(found: Sequence[Noise], directory: Path) -> Path:
    """Write ``noise.json`` and return it."""
    path = directory / "noise.json"
    write_atomic(path, json.dumps(json_ready(list(found)), indent=1))
    return path
