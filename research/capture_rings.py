"""Where the captures went: share of adaptive captures per ring of the pool, by strategy.

python -m research.capture_rings runs/full/evaluation
"""

from __future__ import annotations

import argparse
import collections
from pathlib import Path

from nbv.viewpoints import raw_candidates
from research.decisions import load_traces
from research.paired_cells import markdown_table
from tuner.evaluation.baselines import label
from tuner.evaluation.plan import EvaluationPlan


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("evaluation", type=Path)
    directory = parser.parse_args().evaluation
    plan = EvaluationPlan.load(directory)
    records = plan.records(directory)
    traces = load_traces(records)
    shares: dict[str, collections.Counter[float]] = {}
    for name, config in plan.strategies.items():
        elevation_deg = {v.id: v.elevation_deg for v in raw_candidates(config)}
        evaluated = traces.get(name, {}).values()
        shares[name] = collections.Counter(
            elevation_deg[entry.chosen] for trace in evaluated for entry in trace
        )
    rings = sorted({e for counts in shares.values() for e in counts})
    rows = [
        [
            label(name),
            *(f"{100 * counts[e] / max(1, counts.total()):.0f} %" for e in rings),
            str(counts.total()),
        ]
        for name, counts in shares.items()
    ]
    print("\n".join(markdown_table(["strategy", *(f"{e:g}°" for e in rings), "captures"], rows)))


if __name__ == "__main__":
    main()
