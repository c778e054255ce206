"""What was flown and where its numbers come from, row by row, for a comparison's page."""

from __future__ import annotations

from pathlib import Path

from tuner.evaluation.baselines import description, sees_ground_truth
from tuner.evaluation.baselines import label as strategy_label
from tuner.evaluation.flying import EvaluationRun
from tuner.report.labels import MISSING, format_number
from tuner.report.pages import duration
from tuner.report.provenance import recorded, recorded_rows
from tuner.report.style import short_names


def strategy_row(run: EvaluationRun, name: str) -> dict[str, str]:
    """One strategy: what it does, how many missions, what they cost."""
    own = [r for r in run.records if r.strategy == name]
    done = [r for r in own if r.status != "failed"]

    def mean(key: str) -> float | None:
        values = [float(v) for r in done if isinstance(v := r.costs.get(key), (int, float))]
        return sum(values) / len(values) if values else None

    path, flight, wall = mean("path_length_m"), mean("flight_time_s"), mean("wall_s")
    same = next(n for n, c in run.plan.strategies.items() if c.digest() == run.plan.strategies[name].digest())
    what = description(name)
    if same != name:
        what += f" (the same configuration as {strategy_label(same)}, flown once)"
    return {
        "label": strategy_label(name),
        "description": what + ("; uses the ground truth, not deployable" if sees_ground_truth(name) else ""),
        "missions": str(len(done)),
        "failed": str(len(own) - len(done)),
        "images": format_number(mean("images"), 1),
        "path": MISSING if path is None else f"{path:.0f} m",
        "flight": MISSING if flight is None else duration(flight),
        "wall": MISSING if wall is None else duration(wall),
        "digest": run.plan.strategies[name].digest(),
    }


def provenance_rows(run: EvaluationRun, place: str) -> list[tuple[str, str]]:
    """Rocks, conditions, versions and revisions."""
    presets = sorted({config.preset for config in run.plan.strategies.values()})
    first, last = run.plan.first_replicate, run.plan.first_replicate + run.plan.replicates - 1
    return [
        (f"{place}s", ", ".join(short_names(run.plan.rocks))),
        ("conditions", ", ".join(condition.name for condition in run.plan.conditions)),
        ("replicates", f"{first} to {last}" if last > first else str(first)),
        ("mission preset", ", ".join(presets)),
        *recorded_rows(recorded([Path(r.directory) for r in run.records])),
    ]
