"""One campaign, one evaluation, one reproduction and every command's help: are they still what they were?

    python -m research.baseline            # compare with research/baseline.json, recorded at 431fec0
    python -m research.baseline --write    # record

Geometric missions with fixed seeds and one worker. Numbers are compared to the bit, and where these differ to `CLOSE`:
another processor rounds otherwise.
"""

from __future__ import annotations

import hashlib
import json
import math
import sys
import tempfile
from pathlib import Path
from typing import Any

import typer.main

import tuner
from tuner.cli import app
from tuner.export.records import records_of

FILE = Path(__file__).with_suffix(".json")
MISSIONS: dict[str, Any] = {"fidelity": "geometric", "workers": 1}
TWO_VIEWS = {"stop.adaptive_budget": 2}
COMPARED = ("config.", "metrics.observable.f_score", "metrics.whole.completeness", "costs.")
CLOSE = 1e-7  # relative; a search of ten missions carries rounding on
CLOCKS = ("costs.wall_s", "costs.cpu_s")


def missions(source: Any) -> dict[str, dict[str, Any]]:
    """What is compared of every mission of a campaign or an evaluation."""
    found = {}
    for row in records_of(source):
        which = "trial" if "trial" in row else "strategy"
        name = f"{row[which]} {row['rock']} {row['replicate']}"
        found[name] = {k: v for k, v in row.items() if k.startswith(COMPARED) and k not in CLOCKS}
    return found


def helps(command: Any, name: str = "gatetune") -> dict[str, list[str]]:
    """A digest of the help of a command and of all below it, and the options that each has."""
    about = [command.help, *((p.opts, getattr(p, "help", ""), str(p.default)) for p in command.params)]
    digest = hashlib.sha256(json.dumps(about).encode()).hexdigest()[:12]
    found = {name: [digest, *(option for p in command.params for option in p.opts)]}
    for child, below in getattr(command, "commands", {}).items():
        found |= helps(below, f"{name} {child}")
    return found


def measured(folder: Path) -> dict[str, dict[str, Any]]:
    """Everything that is compared."""
    campaign = tuner.tune(
        folder / "campaign",
        rocks=["slab", "vesicular"],
        space="gate_and_weights",
        budget=10,
        seed=7,
        learn_from=[],
        overrides=TWO_VIEWS,
        **MISSIONS,
    )
    evaluation = tuner.evaluate(campaign, rocks=["arch"], strategies=["hyb-h"], replicates=2, **MISSIONS)
    table = tuner.reproduce(folder / "table", rocks=["slab"], overrides=TWO_VIEWS, **MISSIONS)
    return {
        "campaign": missions(campaign),
        "recommended": dict(campaign.recommendation().values),
        "evaluation": missions(evaluation),
        "reproduction": missions(table),
        "help": helps(typer.main.get_command(app)),
    }


def close(before: Any, now: Any) -> bool:
    """Whether two records, or numbers, are the same but for rounding."""
    if isinstance(before, dict) and isinstance(now, dict):
        return before.keys() == now.keys() and all(close(value, now[key]) for key, value in before.items())
    if isinstance(before, float) and isinstance(now, float):
        return math.isclose(before, now, rel_tol=CLOSE)
    return bool(before == now)


def main() -> None:
    """Record, or compare and print what differs."""
    with tempfile.TemporaryDirectory() as folder:
        now = json.loads(json.dumps(measured(Path(folder))))
    if "--write" in sys.argv:
        FILE.write_text(json.dumps(now, indent=0) + "\n")
        return
    for part, before in json.loads(FILE.read_text()).items():
        same = sum(now[part].get(name) == value for name, value in before.items())
        differs = [name for name, value in before.items() if not close(value, now[part].get(name))]
        rounded = len(before) - same - len(differs)
        print(f"{part}: {same} of {len(before)} the same, {rounded} but for rounding", *differs, sep="\n  ")


if __name__ == "__main__":
    main()
