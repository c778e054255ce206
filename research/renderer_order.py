"""Do strategies come in the same order when photographs are path traced? Our renderer against Mitsuba.

    OMP_NUM_THREADS=1 python -m research.renderer_order fly ROCK ... --out docs/results/data/renderer_order.csv
    python -m research.renderer_order compare docs/results/data/renderer_order.csv [--figure FILE.png]

Preset ``campaign``, replicate 0, on rocks that nothing was tuned on. ``fly`` writes a row per mission and leaves out
those whose row is there; both worlds fly each configuration before the next one. ``compare`` prints Spearman's rank
correlation of the configurations' means, with a bootstrap over rocks, and what matters of the differences.
Photographs are kept in the user's store. ``--world raycast --replicates 2`` flies ours again: how well a world agrees
with itself bounds how well it can agree with another.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from nbv.config import MissionConfig, preset
from nbv.photogrammetric import run_photogrammetric_mission
from research.transfer.agreement import agreement
from tuner.problem import load_search_space

WORLDS = ("mitsuba", "raycast")
HEAD = [
    "configuration",
    "rock",
    "replicate",
    "world",
    "status or reason",
    "F whole",
    "F observable",
    "C2C mean (mm)",
]
TUNED_POOL = {"pool.max_altitude_m": 2.17}


def configurations() -> dict[str, MissionConfig]:
    """Fourteen, fixed before any was flown; the tuned ones are those of docs/results/data/recommendations.csv."""
    weights = ("nov", "move", "ang")

    def tuned(budget: float, d95_m: float, covis: list[float], b_aware: list[float]) -> dict[str, float]:
        gate = {"gate.budget_fraction": budget, "gate.d95_m": d95_m}
        first = {f"covis.weights.{w}": value for w, value in zip(weights, covis, strict=True)}
        return (
            gate | first | {f"b_aware.weights.{w}": value for w, value in zip(weights, b_aware, strict=True)}
        )

    values: dict[str, dict[str, Any]] = {
        "Hyb-H": {},
        "random": {"gate.kind": "random"},
        "tuned": tuned(1, 1, [0.01, 2, 2], [0.125, 0.015, 0.0376]) | TUNED_POOL,
        "random, tuned pool": {"gate.kind": "random"} | TUNED_POOL,
        "Covis": {"gate.kind": "covis"},
        "matchable": {"gate.kind": "matchable"},
        "Hyb-H, pool below 1.5 m": {"pool.max_altitude_m": 1.5},
        "Hyb-H, pool below 2.1 m": {"pool.max_altitude_m": 2.1},
        "tuned, gate_weights_and_pool": tuned(0, 1, [0.172, 0.0528, 0.0626], [2, 0.0361, 0.981])
        | {"pool.max_altitude_m": 2.13},
        "tuned, gate_and_weights": tuned(0.0359, 0.05, [0.0742, 0.121, 1.16], [0.415, 0.0491, 2]),
        "B-aware": {"gate.kind": "b-aware"},
    }
    space, rng = load_search_space("beyond_paper"), np.random.default_rng(0)
    for k in range(3):
        values[f"draw {k + 1}"] = space.base | space.complete(space.from_unit(rng.random(space.dimension)))
    return {name: preset("campaign").with_values(changed) for name, changed in values.items()}


def fly(rocks: list[str], worlds: list[str], replicates: int, out: Path) -> None:
    """A row per mission that has none yet."""
    done = {(row["configuration"], row["rock"], row["replicate"], row["world"]) for row in read(out)}
    with out.open("a", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        if not done:
            rows.writerow(HEAD)
        for replicate in range(replicates):
            for path in rocks:
                for name, config in configurations().items():
                    for world in worlds:
                        block = (name, Path(path).stem, str(replicate), world)
                        if block in done:
                            continue
                        flown = run_photogrammetric_mission(
                            config.with_values({"scene.backend": world}), path, replicate
                        )
                        surfaces = [flown.metrics.get(s, {}) for s in ("whole", "observable")]
                        values = [
                            *(f"{s['f_score_48mm']:.2f}" if s else "" for s in surfaces),
                            f"{surfaces[0]['c2c_mean_mm']:.2f}" if surfaces[0] else "",
                        ]
                        rows.writerow([*block, flown.reason or flown.status, *values])
                        file.flush()


def read(path: Path) -> list[dict[str, str]]:
    """Rows of the file; none if there is none."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def outcomes(path: Path, column: str) -> dict[str, dict[str, dict[tuple[str, int], float]]]:
    """By world, configuration and (rock, replicate); larger is better."""
    sign = -1.0 if column.startswith("C2C") else 1.0
    worlds: dict[str, dict[str, dict[tuple[str, int], float]]] = {world: {} for world in WORLDS}
    for row in read(path):
        if row[column]:
            own = worlds[row["world"]].setdefault(row["configuration"], {})
            own[row["rock"], int(row["replicate"])] = sign * float(row[column])
    return worlds


def compare(path: Path) -> None:
    """Print what the missions say."""
    for column in HEAD[-3:]:
        worlds = outcomes(path, column)
        rocks = sorted({rock for own in worlds["mitsuba"].values() for rock, _ in own})
        print(f"\n{column}")
        for rock in [None, *rocks]:
            traced, ours = (
                {n: {k: v for k, v in own.items() if rock in (None, k[0])} for n, own in worlds[w].items()}
                for w in WORLDS
            )
            first = {n: {k: v for k, v in own.items() if k[1] == 0} for n, own in ours.items()}
            again = {n: {(k[0], 0): v for k, v in own.items() if k[1] == 1} for n, own in ours.items()}
            found, own = agreement(first, traced), agreement(first, again).spearman
            rho = found.spearman
            print(
                f"  {rock or 'all'}: {len(found.configurations)} configurations, {found.blocks} blocks;",
                end=" ",
            )
            print(f"Spearman {rho.value} [{rho.low}, {rho.high}]; ours, replicate 0 and 1: {own.value}")
            print(f"    chosen by ours: {found.chosen}; Mitsuba's best: {found.best}; regret {found.regret}")
        for world, by_name in worlds.items():
            for reference in ("Hyb-H", "random, tuned pool"):
                both = by_name.get("tuned", {}).keys() & by_name.get(reference, {}).keys()
                gains = [by_name["tuned"][k] - by_name[reference][k] for k in sorted(both)]
                print(f"  {world}: tuned - {reference}: {np.mean(gains):+.2f}", [f"{g:+.2f}" for g in gains])


def draw(path: Path, png: Path) -> None:
    """The configurations' means over rocks, replicate 0, in both worlds."""
    worlds = outcomes(path, "F whole")
    figure, axes = plt.subplots(figsize=(6, 5))
    for name, blocks in worlds["raycast"].items():
        traced = worlds["mitsuba"][name]
        x, y = (float(np.mean([own[k] for k in traced if k in blocks])) for own in (blocks, traced))
        axes.plot(x, y, "o", color="#D55E00" if name == "tuned" else "#0072B2")
        axes.annotate(name, (x, y), xytext=(4, 3), textcoords="offset points", fontsize=7)
    axes.set_xlabel("our renderer, F-score @ 48 mm (%)")
    axes.set_ylabel("Mitsuba, F-score @ 48 mm (%)")
    axes.grid(alpha=0.3)
    figure.savefig(png, dpi=110, bbox_inches="tight", metadata={"Software": None})


def main() -> None:
    """See the module's text."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    commands = parser.add_subparsers(dest="command", required=True)
    flying = commands.add_parser("fly")
    flying.add_argument("rocks", nargs="+")
    flying.add_argument("--world", nargs="+", choices=WORLDS, default=[*WORLDS])
    flying.add_argument("--replicates", type=int, default=1)
    flying.add_argument("--out", type=Path, required=True)
    comparing = commands.add_parser("compare")
    comparing.add_argument("file", type=Path)
    comparing.add_argument("--figure", type=Path)
    arguments = parser.parse_args()
    if arguments.command == "fly":
        fly(arguments.rocks, arguments.world, arguments.replicates, arguments.out)
        return
    compare(arguments.file)
    if arguments.figure:
        draw(arguments.file, arguments.figure)


if __name__ == "__main__":
    main()
