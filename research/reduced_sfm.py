"""What preset ``paper-reduced`` leaves out (`nbv.config.REDUCED_SFM`), and what that does to the outcome.

    OMP_NUM_THREADS=1 python -m research.reduced_sfm [--rocks boulder slab] [--replicates 1] [--parts all adjustment]
    OMP_NUM_THREADS=1 python -m research.reduced_sfm --presets [--rocks boulder]

The views are drawn at random, by rock and replicate alone, so that the missions of one flight differ in nothing but
the reductions. Part "none" is preset ``paper``, "all" is ``paper-reduced``, the others are a few: see `PARTS`. Features
and pairs come from the user's store where it has them, so the CPU seconds of a stage count only where nothing of it is
kept: mapping, bundle adjustment, dense stage.

With ``--presets`` both presets fly their own missions (Hyb-H, 24 + 40), each with an empty store.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from nbv.config import REDUCED_SFM, MissionConfig, preset
from research.fresh_process import fly_for_record, fly_in_fresh_process

PAIRS = ("sparse.max_pairs", "sparse.max_pair_angle_deg")
VERIFICATION = ("sparse.min_ransac_trials",)
ADJUSTMENT = (
    "sparse.global_ba_interval",
    "sparse.local_ba_images",
    "sparse.local_ba_rounds",
    "sparse.local_ba_iterations",
    "sparse.global_ba_iterations",
)
TABLES = ("sparse.update_pairs",)
STEREO = ("dense.min_baseline_angle_deg", "dense.search")
PARTS: dict[str, tuple[str, ...]] = {
    "none": (),
    "pairs": PAIRS,
    "verification": VERIFICATION,
    "adjustment": ADJUSTMENT,
    "tables": TABLES,
    "dense": STEREO,
    "all": tuple(REDUCED_SFM),
}
METRICS = (
    "f_score_48mm",
    "f_score_16mm",
    "completeness_16mm",
    "accuracy_16mm",
    "c2c_mean_mm",
    "hausdorff_gt_to_cloud_mm",
)
STAGES = {"mapping": "sparse.mapping", "adjustment": "sparse.ba", "dense": "dense"}


def configuration(part: str, budget: int) -> MissionConfig:
    """Random views, with some reductions."""
    return MissionConfig().with_values(
        {
            **{path: REDUCED_SFM[path] for path in PARTS[part]},
            "gate.kind": "random",
            "stop.criterion": "budget",
            "stop.adaptive_budget": budget,
        }
    )


def fly(rock: str, replicate: int, part: str, budget: int) -> dict[str, Any]:
    """One flight with some reductions, as a line of the record."""
    config = configuration(part, budget)
    flown, line = fly_for_record(config, rock, replicate, {"part": part, "budget": budget}, METRICS)
    result = flown.result
    return {
        **line,
        "config_digest": result.config_digest,
        "n_registered": int(result.costs["registered_images"]),
        "alignment_rms_mm": 1e3 * result.trace[-1].alignment_rms_m,
    }


def table(lines: Sequence[dict[str, Any]]) -> str:
    """Means by part, and the paired difference from part "none" (mean, largest absolute)."""
    flights: dict[tuple[str, int], dict[str, dict[str, Any]]] = {}
    for line in lines:
        flights.setdefault((line["rock"], line["replicate"]), {})[line["part"]] = line
    rows = [
        f"| reductions | flights | registered | sparse points | {' | '.join(f'{s}, CPU s' for s in STAGES)} | "
        + " | ".join(METRICS)
        + " |",
        "|---" * (4 + len(STAGES) + len(METRICS)) + "|",
    ]
    for part in PARTS:
        paired = [(f["none"], f[part]) for f in flights.values() if "none" in f and part in f]
        if not paired:
            continue
        if any(a["views"] != b["views"] for a, b in paired):
            raise SystemExit(f"flights with parts none and {part} have different views")
        cells = [
            f"{statistics.mean(b['timings_s'].get(s, 0.0) for _, b in paired):.1f}" for s in STAGES.values()
        ]
        for name in METRICS:
            differences = [b[name] - a[name] for a, b in paired]
            mean = statistics.mean(b[name] for _, b in paired)
            cells.append(
                f"{mean:.3f} ({statistics.mean(differences):+.3f}, {max(map(abs, differences)):.3f})"
            )
        rows.append(
            f"| {part} | {len(paired)} | {min(b['n_registered'] for _, b in paired)} | "
            f"{statistics.mean(b['n_points'] for _, b in paired):.0f} | " + " | ".join(cells) + " |"
        )
    return "\n".join(rows)


def compare_presets(rock: str) -> None:
    """Fly both presets with nothing cached; print what each costs, what it gives, and the views that they share."""
    views: dict[str, list[str]] = {}
    for name in ("paper", "paper-reduced"):
        with tempfile.TemporaryDirectory() as home:
            flown = fly_in_fresh_process(preset(name), rock, 0, Path(home))
        observable = flown.result.metrics["observable"]
        views[name] = [step.chosen for step in flown.result.trace]
        print(
            f"{rock}, {name}: {flown.wall_s:.0f} s wall, {flown.cpu_s:.0f} s CPU, "
            + ", ".join(f"{metric} {observable[metric]:.3f}" for metric in METRICS),
            flush=True,
        )
    paper, reduced = views["paper"], views["paper-reduced"]
    same = next((i for i, (a, b) in enumerate(zip(paper, reduced)) if a != b), len(paper))
    print(
        f"{rock}: {len(set(paper) & set(reduced))} of {len(paper)} views shared, the first {same} in the same order"
    )


def main() -> None:
    """Fly what is not in the record yet; print the table of all of it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rocks", nargs="+", default=["boulder", "slab", "vesicular", "cavern"])
    parser.add_argument("--replicates", type=int, default=1)
    parser.add_argument("--parts", nargs="+", choices=list(PARTS), default=["none", "all"])
    parser.add_argument("--budget", type=int, default=40)
    parser.add_argument("--out", type=Path, default=Path("runs/reduced_sfm.jsonl"))
    parser.add_argument("--presets", action="store_true", help="fly the two presets' own missions instead")
    arguments = parser.parse_args()
    if arguments.presets:
        for rock in arguments.rocks:
            compare_presets(rock)
        return
    lines = [json.loads(x) for x in arguments.out.read_text().splitlines()] if arguments.out.is_file() else []
    digests = {part: configuration(part, arguments.budget).digest() for part in PARTS}
    lines = [x for x in lines if x["config_digest"] == digests[x["part"]]]  # of today's reductions and budget
    done = {(x["rock"], x["replicate"], x["part"]) for x in lines}
    for replicate in range(arguments.replicates):
        for rock in arguments.rocks:
            for part in arguments.parts:
                if (Path(rock).stem, replicate, part) in done:
                    continue
                lines.append(fly(rock, replicate, part, arguments.budget))
                with arguments.out.open("a") as record:
                    print(json.dumps(lines[-1]), file=record)
                print({k: v for k, v in lines[-1].items() if k not in ("views", "timings_s")}, flush=True)
    print(table(lines))


if __name__ == "__main__":
    main()
