"""Does the low-fidelity simulator rank, and fail, as photogrammetry does in the space few_photographs?

    OMP_NUM_THREADS=1 python -m research.few_photographs_rank --rocks slab vesicular cleft --out rank.csv

The default, then in turn points near it and anywhere, run with photographs (replicate 0) and geometrically (mean of
replicates 0 to 2) on each rock. Spearman's rank correlation of the F-scores at 48 mm (observable surface, preset `campaign`),
a failed mission the worst, 95 % bootstrap percentiles over configurations. Goes on where a file ends.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from nbv.config import MissionConfig, preset
from nbv.geometric import run_geometric_mission
from nbv.photogrammetric import run_photogrammetric_mission
from tuner.problem.space_files import load_search_space
from tuner.samplers.design import near_default, sobol_point

SPACE, METRIC, GEOMETRIC_REPLICATES, BOOTSTRAP = "few_photographs", "observable.f_score_48mm", 3, 2000
HEAD = (
    "rock",
    "configuration",
    "photogrammetric",
    "photogrammetric_reason",
    "registered",
    "geometric",
    "geometric_failed",
    "geometric_registered",
)


def run_missions(rocks: list[str], count: int, out: Path) -> None:
    """Append what is missing."""
    done = set()
    if out.exists():
        with out.open(newline="") as file:
            done = {(r["rock"], int(r["configuration"])) for r in csv.DictReader(file)}
    space, base = load_search_space(SPACE), preset("campaign")
    default = space.default(base)
    with out.open("a", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        if not done:
            rows.writerow(HEAD)
        for i in range(count):
            point = near_default(space, default, 0, i // 2) if i % 2 else sobol_point(space, 0, i // 2)
            config = space.config(base, point if i else default)
            for rock in rocks:
                if (rock, i) in done:
                    continue
                real = run_photogrammetric_mission(config, rock, 0)
                measured = "" if real.status == "failed" else f"{real.metric(METRIC):.3f}"
                registered = round(real.costs["registered_images"])
                rows.writerow([rock, i, measured, real.reason or "-", registered, *simulated(config, rock)])
                file.flush()


def simulated(config: MissionConfig, rock: str) -> tuple[str, int, str]:
    """Mean F-score of what did not fail, how many replicates failed, mean number of registered photographs."""
    results = [run_geometric_mission(config, rock, k) for k in range(GEOMETRIC_REPLICATES)]
    found = [result.metric(METRIC) for result in results if result.status != "failed"]
    registered = np.mean([result.costs["registered_images"] for result in results])
    return f"{np.mean(found):.3f}" if found else "", len(results) - len(found), f"{registered:.1f}"


def tell(out: Path) -> None:
    """Per rock: rank correlation with its interval, and how often both sides register."""
    with out.open(newline="") as file:
        rows = list(csv.DictReader(file))
    for rock in (*dict.fromkeys(r["rock"] for r in rows), "mean"):
        own = [r for r in rows if r["rock"] == rock]
        if rock == "mean":
            drawn = [spearman(rows, chosen) for chosen in bootstrap(rows)]
            print(f"mean over rocks: {spearman(rows):.2f}", np.nanpercentile(drawn, [2.5, 97.5]).round(2))
            continue
        drawn = [spearman(own, chosen) for chosen in bootstrap(own)]
        fails = [(not r["photogrammetric"], int(r["geometric_failed"]) > 0) for r in own]
        counts = np.array([[float(r["registered"]), float(r["geometric_registered"])] for r in own])
        print(
            f"{rock}: {len(own)} configurations, Spearman {spearman(own):.2f}",
            np.nanpercentile(drawn, [2.5, 97.5]).round(2),
            f"registered {counts.mean(axis=0).round(1)}, Spearman {spearmanr(*counts.T).statistic:.2f}; fail photogrammetric only "
            f"{sum(a and not b for a, b in fails)}, geometric only {sum(b and not a for a, b in fails)}, both {sum(a and b for a, b in fails)}",
        )


def bootstrap(rows: list[dict[str, str]]) -> Iterator[list[str]]:
    """Configurations drawn again."""
    rng = np.random.default_rng(0)
    known = sorted({r["configuration"] for r in rows})
    for _ in range(BOOTSTRAP):
        yield [str(c) for c in rng.choice(known, len(known))]


def spearman(rows: list[dict[str, str]], chosen: list[str] | None = None) -> float:
    """Rank correlation of the F-scores, a failed mission the worst; its mean over rocks."""
    found = []
    for rock in dict.fromkeys(r["rock"] for r in rows):
        own = {r["configuration"]: r for r in rows if r["rock"] == rock}
        pairs = [
            [float(own[c][side] or 0.0) for side in ("photogrammetric", "geometric")]
            for c in chosen or own
            if c in own
        ]
        found.append(spearmanr(*np.array(pairs).T).statistic)
    return float(np.mean(found))


def main() -> None:
    """Run what is not in the file yet, then tell."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rocks", nargs="+", required=True)
    parser.add_argument("--configurations", type=int, default=24)
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    run_missions(arguments.rocks, arguments.configurations, arguments.out)
    tell(arguments.out)


if __name__ == "__main__":
    main()
