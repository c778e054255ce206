"""Evaluations with known outcomes: complete metrics, made from a level per strategy, without running a mission."""

import zlib
from pathlib import Path
from typing import Any

import numpy as np

from nbv.config import preset
from tuner.comparison.of_campaign import PlannedComparison
from tuner.comparison.plan import EvaluationPlan, EvaluationRun
from tuner.missions.job import Record, Trial
from tuner.problem.goal import Goal
from tuner.report.comparison import ComparisonFacts


def made_metrics(quality: float) -> dict[str, object]:
    """All metrics of a mission; ``quality`` is the F-score at 48 mm in percent."""
    surface: dict[str, object] = {
        "hausdorff_gt_to_cloud_mm": 900 - 5 * quality,
        "c2c_mean_mm": 140 - quality,
        "c2c_median_mm": 90 - 0.7 * quality,
        "c2c_p95_mm": 420 - 2.5 * quality,
        "completeness_48mm": quality - 9,
        "f_score_48mm": quality,
        "completeness_80mm": quality + 4,
        "f_score_80mm": quality + 11,
        "sector_completeness_48mm": [quality + 8 * np.sin(k) for k in range(12)],
    }
    observable = {**surface, "f_score_48mm": quality + 3}
    return {"whole": surface, "observable": observable, "sector_centers_deg": [*np.arange(15.0, 360, 30)]}


def made_trial(strategy: str, rock: str, replicate: int, *, reason: str = "", **record: Any) -> Trial:
    """A mission of an evaluation, and what its record says."""
    said = Record(**{"status": "ok", **record})
    return Trial(strategy=strategy, rock=rock, replicate=replicate, reason=reason, record=said)


def made_run(
    levels: dict[str, float],
    rocks: tuple[str, ...] = ("cobble", "slab", "overhang", "pillar"),
    replicates: int = 3,
    noise: float = 1.0,
    failed: tuple[tuple[str, str, int], ...] = (),
) -> EvaluationRun:
    """Every strategy's F-score is its level + the rock's shift + noise; ``failed`` missions have none."""
    base = preset("campaign")
    own: dict[str, dict[str, Any]] = {"tuned": {"gate.budget_fraction": 0.1}}
    strategies = {name: base.with_values(own.get(name, {"gate.kind": name})) for name in levels}
    plan = EvaluationPlan(strategies, rocks, replicates)
    records = []
    for name, level in levels.items():
        for r, rock in enumerate(rocks):
            for k in range(replicates):
                rng = np.random.default_rng(zlib.crc32(f"{name} {rock} {k}".encode()))
                if (name, rock, k) in failed:
                    records.append(made_trial(name, rock, k, reason="seed_model_failed", status="failed"))
                else:
                    metrics = made_metrics(level + 4 * r + noise * rng.normal())
                    costs = {
                        "images": 32.0,
                        "path_length_m": 61.0 + r,
                        "flight_time_s": 190.0,
                    }
                    records.append(made_trial(name, rock, k, measured={"metrics": metrics, "costs": costs}))
    return EvaluationRun(plan, records, True, 1.0, Path())


def made_facts(run: EvaluationRun, goal: Goal | None = None) -> ComparisonFacts:
    """What was found, by default in the quality, against Hyb-H."""
    planned = PlannedComparison(run.plan, "hyb-h", "Strategies compared", Path(), goal=goal or Goal())
    return ComparisonFacts(planned, run)
