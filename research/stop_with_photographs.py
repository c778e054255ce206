"""Photographs until a target is done, rendered and in `indoors`: the stop by prediction against an orbit by the height.

    python -m research.stop_with_photographs stops.csv --targets part-20001 head-20000 arch cleft

*predicted* begins with 12 seeds on a ring at 10° and stops at a predicted F-score. The orbit at 15° has L + 20 ln(h / 1 m)
photographs, where h is the height that a mission is told (a drawn shape's is known to 20 %). Every mission is a row of the file,
which is read first: missions that it holds are not flown again. Then the table is printed.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from nbv.cache import Store
from nbv.config import MissionConfig, load_condition, preset, under
from nbv.mission.target_prior import with_size_error
from nbv.rocks import load_coarse_rock
from nbv.rocks.families import generated_name
from research import read_rows, write_rows
from research.adaptive_plans import BASE
from research.planned_photographs import flown
from tuner.comparison.curves import PHOTOGRAPHS_PER_LOG_HEIGHT

LEVELS, STOPS_PERCENT = (8, 16, 24), (95.0, 98.0)
FEWEST, MOST, SEEDS = 10, 40, 12
HEAD = ("plan", "setting", "target", "photographs", "f_score")
GOALS = (95.0, 98.0)


def configurations(base: MissionConfig, target: str) -> dict[tuple[str, float], MissionConfig]:
    """By plan and setting."""
    height_m = 2.0 * with_size_error(base, load_coarse_rock(target, Store()), 0).target_m[2]
    found = {}
    for level in LEVELS:
        number = round(float(np.clip(level + PHOTOGRAPHS_PER_LOG_HEIGHT * np.log(height_m), FEWEST, MOST)))
        values = {"photographs": number, "seeds": number, "seed.lowest_deg": 15.0}
        found["orbit by the height", float(level)] = base.with_values(values)
    planned = {"photographs": MOST, "seeds": SEEDS, "gate.kind": "predicted", "stop.criterion": "predicted"}
    for percent in STOPS_PERCENT:
        found["predicted", percent] = base.with_values({**planned, "stop.predicted_percent": percent})
    return found


def table(rows: Sequence[dict[str, str]]) -> list[str]:
    """A line for kind of target, plan and setting: photographs, F-score, and on how many targets it reaches the goals."""
    groups: dict[tuple[str, str, str], list[dict[str, str]]] = {}
    for row in rows:
        kind = "rocks" if generated_name(row["target"]) is None else "shapes"
        groups.setdefault((kind, row["plan"], row["setting"]), []).append(row)
    lines = ["|kind|plan|setting|targets|photographs|F-score|" + "|".join(f"F ≥ {g:g}" for g in GOALS) + "|"]
    lines.append("|-|-|-:|-:|-:|-:|" + "-:|" * len(GOALS))
    for group, own in sorted(groups.items()):
        numbers = [float(row["photographs"]) for row in own]
        scores = np.array([float(row["f_score"]) for row in own])
        cells = [*group, len(own), f"{np.mean(numbers):.1f}", f"{scores.mean():.1f}"]
        lines.append("|".join(["", *map(str, cells), *(str((scores >= g).sum()) for g in GOALS), ""]))
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("file", type=Path)
    parser.add_argument("--targets", nargs="*", default=[])
    asked = parser.parse_args()
    rows = read_rows(asked.file)
    done = {(row["plan"], float(row["setting"]), row["target"]) for row in rows}
    base = under(preset("campaign").with_values(BASE), load_condition("indoors"))
    for target in asked.targets:
        for (plan, setting), config in configurations(base, target).items():
            if (plan, setting, target) in done:
                continue
            found = flown(config, target, 0)
            rows.append(
                {"plan": plan, "setting": setting, "target": target, "photographs": found["images"], **found}
            )
            print(rows[-1], flush=True)
            write_rows(asked.file, HEAD, rows)
    print("\n".join(table(rows)))


if __name__ == "__main__":
    main()
