"""Tables and figures from the result files of ``optimiser_comparison.py``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nbv.types import Floats

DRAWS = 10_000
MIN_SEEDS = 3  # fewer common seeds get no interval
# Values this near are the same: on geometric missions a plateau of equal views has steps of 0.001 points of F-score,
# replicates of one mission differ by a tenth of a point; the functions are in standard deviations.
PLATEAU = 0.002
# The same outcomes averaged in another order differ by 1e-9, which is no difference between optimisers.
TRUTH_DIGITS = 6


@dataclass(frozen=True)
class Run:
    """One (problem, strategy, seed)."""

    problem: str
    strategy: str
    seed: int
    budget: float
    best: float | None
    costs: Floats  # of the checkpoints
    truths: Floats
    ask_s: Floats  # CPU seconds of the asks that were not trivial
    left_out: float | None = None  # share inside of the leave-one-out 95 % intervals, all missions run

    def reached(self, level: float) -> float:
        """Cost at which the recommendation was first as good as ``level``; infinite if never."""
        there = self.costs[self.truths >= level - PLATEAU]
        return float(there[0]) if len(there) else float("inf")

    def at(self, share: float) -> float:
        """Value of the recommendation at the first checkpoint after ``share`` of the budget."""
        return float(self.truths[self.costs >= share * self.budget - 1e-6][0])


def read(path: Path) -> Run | None:
    """A complete run; None otherwise."""
    text = path.read_text()
    if '"kind": "done"' not in text:
        return None
    rows: list[dict[str, Any]] = [json.loads(line) for line in text.splitlines()]
    head = rows[0]
    points = [r for r in rows if r["kind"] == "checkpoint"]
    missions = [r for r in rows if r["kind"] == "mission"]
    return Run(
        head["problem"],
        head["strategy"],
        head["seed"],
        head["budget"],
        head["best"],
        np.array([p["cost"] for p in points]),
        np.array([p["truth"] for p in points]).round(TRUTH_DIGITS),
        np.array([m["ask_s"] for m in missions if m["ask_s"] > 1e-3]),
        points[-1].get("loo"),
    )


def paired_interval(differences: Floats) -> tuple[float, float, float]:
    """``(mean, low, high)``: 95 % bootstrap interval of the mean paired difference."""
    rng = np.random.default_rng(0)
    means = rng.choice(differences, (DRAWS, len(differences))).mean(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return float(differences.mean()), float(low), float(high)


Table = dict[str, dict[int, Run]]  # strategy -> seed -> run


def load(out: Path, problems: Sequence[str] | None, strategies: Sequence[str] | None) -> dict[str, Table]:
    """Runs by problem, strategy and seed."""
    found: dict[str, Table] = {}
    for path in sorted(out.rglob("*.jsonl")):
        run = read(path)
        if run is None or (problems and run.problem not in problems):
            continue
        if strategies and run.strategy not in strategies:
            continue
        found.setdefault(run.problem, {}).setdefault(run.strategy, {})[run.seed] = run
    return found


def rows(table: Table, ours: str) -> list[str]:
    """Markdown lines, best median first. Seeds are those that ``ours`` and the strategy share."""
    mine = table.get(ours, {})
    final = {name: np.median([r.truths[-1] for r in runs.values()]) for name, runs in table.items()}
    lines = []
    for name in sorted(table, key=lambda n: -final[n]):
        runs = table[name]
        common = sorted(set(runs) & set(mine))
        difference = ratio = "" if name != ours else "–"
        if name != ours and common:
            gaps = np.array([mine[s].truths[-1] - runs[s].truths[-1] for s in common])
            difference = f"{gaps.mean():+.3f} ({len(common)} seed{'s' * (len(common) > 1)})"
            if len(common) >= MIN_SEEDS:
                mean, low, high = paired_interval(gaps)
                difference = f"{mean:+.3f} ({low:+.3f} to {high:+.3f})"
            shares = [mine[s].reached(runs[s].truths[-1]) / runs[s].budget for s in common]
            middle = float(np.median(shares))
            ratio = f"{middle:.2f}" if np.isfinite(middle) else "not reached"
        left_out = [r.left_out for r in runs.values() if r.left_out is not None]
        inside = f"{100 * np.mean(left_out):.0f}" if name.startswith("gp") and left_out else ""
        asks = np.concatenate([r.ask_s for r in runs.values()])
        worst = min(r.truths[-1] for r in runs.values())
        lines.append(
            f"| {name} | {len(runs)} | {final[name]:.3f} | {worst:.3f} | {difference} | {ratio} | "
            f"{np.median(asks) if len(asks) else 0:.2f} | {inside} |"
        )
    return lines


PEER_SHARES = (0.2, 0.4, 0.6, 0.8, 1.0)  # of the budget: where peers are looked at
EQUAL_HEAD = (
    "| ours minus it after this share of the budget | "
    + " | ".join(f"{share:.0%}" for share in PEER_SHARES)
    + " |\n|---|"
    + "---|" * len(PEER_SHARES)
)


def at_equal_cost(table: Table, ours: str) -> list[str]:
    """Markdown lines: ours minus each strategy at the same cost, mean and 95 % over common seeds."""
    mine = table.get(ours, {})
    lines = []
    for name, runs in table.items():
        common = sorted(set(runs) & set(mine))
        if name == ours or len(common) < MIN_SEEDS:
            continue
        cells = []
        for share in PEER_SHARES:
            gaps = [mine[s].at(share) - runs[s].at(share) for s in common]
            mean, low, high = paired_interval(np.array(gaps))
            cells.append(f"{mean:+.3f} ({low:+.3f} to {high:+.3f})")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return lines


HEAD = (
    "| strategy | seeds | median | worst | ours minus this (mean, 95 %) | cost ratio | ask, CPU s | in 95 %: ahead / widened / left out |\n"
    "|---|---:|---:|---:|---|---:|---:|---:|"
)


def against_best_peer(found: dict[str, Table], ours: str) -> list[str]:
    """One Markdown line per problem: ours and the peer with the best median among those with most seeds.

    Strategies whose names begin with ``ours`` are variants, not peers.
    """
    lines = []
    for problem, table in found.items():
        mine = table.get(ours, {})
        common = {n: sorted(set(r) & set(mine)) for n, r in table.items() if not n.startswith(ours)}
        most = max((len(seeds) for seeds in common.values()), default=0)
        peers = [n for n, seeds in common.items() if len(seeds) == most >= MIN_SEEDS]
        if not peers:
            continue
        best = max(peers, key=lambda n: float(np.median([r.truths[-1] for r in table[n].values()])))
        gaps = {
            n: np.array([mine[s].truths[-1] - table[n][s].truths[-1] for s in common[n]])
            for n in common
            if len(common[n]) >= MIN_SEEDS
        }
        mean, low, high = paired_interval(gaps[best])
        better = [n for n, gap in gaps.items() if paired_interval(gap)[2] < 0]
        shares = [mine[s].reached(table[best][s].truths[-1]) / table[best][s].budget for s in common[best]]
        middle = float(np.median(shares))
        ratio = f"{middle:.2f}" if np.isfinite(middle) else "not reached"
        lines.append(
            f"| {problem} | {best} | {most} | {mean:+.3f} ({low:+.3f} to {high:+.3f}) | {ratio} | "
            f"{', '.join(better) or 'none'} |"
        )
    return lines


BEST_HEAD = (
    "| problem | best peer | seeds | ours minus it (mean, 95 %) | cost ratio | significantly better than ours |\n"
    "|---|---|---:|---:|---:|---|"
)


def summarise(
    out: Path,
    ours: str,
    problems: Sequence[str] | None,
    strategies: Sequence[str] | None,
) -> None:
    """Print one table per problem."""
    found = load(out, problems, strategies)
    print(f"{BEST_HEAD}\n" + "\n".join(against_best_peer(found, ours)))
    for problem, table in found.items():
        best = next(iter(next(iter(table.values())).values())).best
        print(f"\n### {problem}{'' if best is None else f' (optimum {best:.3f})'}\n\n{HEAD}")
        print("\n".join(rows(table, ours)))
        print(f"\n{EQUAL_HEAD}\n" + "\n".join(at_equal_cost(table, ours)))
