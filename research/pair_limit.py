"""What fewer matched pairs save, and what they cost: paper missions along the same views, ``sparse.max_pairs`` varied.

    OMP_NUM_THREADS=1 python -m research.pair_limit [--rocks boulder vesicular] [--replicates 2] [--limits 24 12]

The views are drawn at random, by rock and replicate alone, so that the missions of one flight differ in nothing but
their pairs. Features and pairs come from the user's store where it has them: the CPU seconds are those of mapping,
dense reconstruction and evaluation, and of what was missing from the store.
"""

from __future__ import annotations

import argparse
import json
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from nbv.config import MissionConfig
from research.fresh_process import fly_for_record

METRICS = ("f_score_48mm", "f_score_16mm", "completeness_16mm", "accuracy_16mm", "c2c_mean_mm")


def fly(rock: str, replicate: int, limit: int, budget: int) -> dict[str, Any]:
    """One flight with one limit, as a line of the record."""
    config = MissionConfig().with_values(  # nothing else reduced: see reduced_sfm.py
        {
            "gate.kind": "random",
            "sparse.max_pairs": limit,
            "stop.criterion": "budget",
            "stop.adaptive_budget": budget,
        }
    )
    flown, line = fly_for_record(config, rock, replicate, {"limit": limit, "budget": budget}, METRICS)
    return {**line, "peak_rss_mb": flown.peak_rss_mb, "n_registered": flown.result.trace[-1].n_registered}


def table(lines: Sequence[dict[str, Any]]) -> str:
    """Means by limit, and the paired difference from the largest number of pairs (mean, largest absolute)."""
    flights: dict[tuple[str, int], dict[int, dict[str, Any]]] = {}
    for line in lines:
        flights.setdefault((line["rock"], line["replicate"]), {})[line["limit"]] = line
    limits = sorted({line["limit"] for line in lines}, key=lambda n: -n if n else -(10**6))
    rows = [
        "| max_pairs | flights | CPU s | " + " | ".join(METRICS) + " |",
        "|---|---|---|" + "---|" * len(METRICS),
    ]
    for limit in limits:
        paired = [(f[limits[0]], f[limit]) for f in flights.values() if limits[0] in f and limit in f]
        if any(a["views"] != b["views"] for a, b in paired):
            raise SystemExit(f"flights with limits {limits[0]} and {limit} have different views")
        cells = []
        for name in METRICS:
            differences = [b[name] - a[name] for a, b in paired]
            mean = statistics.mean(b[name] for _, b in paired)
            cells.append(
                f"{mean:.3f} ({statistics.mean(differences):+.3f}, {max(map(abs, differences)):.3f})"
            )
        cpu_s = statistics.mean(b["cpu_s"] for _, b in paired)
        rows.append(f"| {limit or 'all'} | {len(paired)} | {cpu_s:.0f} | " + " | ".join(cells) + " |")
    return "\n".join(rows)


def main() -> None:
    """Fly what is not in the record yet; print the table of all of it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rocks", nargs="+", default=["boulder", "vesicular"])
    parser.add_argument("--replicates", type=int, default=2)
    parser.add_argument("--limits", nargs="+", type=int, default=[24, 16, 12, 8])
    parser.add_argument("--budget", type=int, default=40)
    parser.add_argument("--out", type=Path, default=Path("runs/pair_limit.jsonl"))
    arguments = parser.parse_args()
    lines = [json.loads(x) for x in arguments.out.read_text().splitlines()] if arguments.out.is_file() else []
    done = {(x["rock"], x["replicate"], x["limit"], x["budget"]) for x in lines}
    for replicate in range(arguments.replicates):
        for rock in arguments.rocks:
            for limit in arguments.limits:
                if (Path(rock).stem, replicate, limit, arguments.budget) in done:
                    continue
                lines.append(fly(rock, replicate, limit, arguments.budget))
                with arguments.out.open("a") as record:
                    print(json.dumps(lines[-1]), file=record)
                print({k: v for k, v in lines[-1].items() if k not in ("views", "timings_s")}, flush=True)
    print(table([x for x in lines if x["budget"] == arguments.budget]))


if __name__ == "__main__":
    main()
