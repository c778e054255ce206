"""Make a finished campaign one of those that come with the program (``tuner/campaign/shipped.py``).

    OMP_NUM_THREADS=1 gatetune campaign run --name shipped --space full --fidelity geometric --budget 96 --workers 1 \\
        --rock slab --rock vesicular --rock breccia --rock cavern --learn-from nothing
    python -m research.ship_missions runs/shipped

Only procedural training rocks: a real or held-out rock must not reach what every user's campaign begins with.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from nbv.errors import UserError
from nbv.rocks.recipes import RECIPES
from tuner.campaign.campaign import Campaign
from tuner.campaign.shipped import DIRECTORY, NOTHING
from tuner.report.pages import recorded


def main() -> None:
    """Read the run directory, write the file."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("run", type=Path)
    arguments = parser.parse_args()
    try:
        campaign = Campaign.open(arguments.run, read_only=True)
    except UserError as error:
        parser.error(str(error))
    s = campaign.settings
    wrong = [rock for rock in s.rocks if rock not in RECIPES or RECIPES[rock].split != "train"]
    if wrong:
        parser.error(f"{wrong[0]!r} is not a procedural training rock")
    if campaign.status().remaining:
        parser.error(f"{arguments.run} is not finished")
    if s.sources:
        parser.error(f"{arguments.run} learned from other campaigns; run it with --learn-from {NOTHING}")
    rocks = " ".join(f"--rock {rock}" for rock in s.rocks)
    command = (
        f"gatetune campaign run --name shipped --space {s.space.name} --fidelity {s.fidelity} --budget {s.budget} "
        f"--replicates {s.replicates} --seed {s.seed} {rocks} --learn-from {NOTHING}"
    )
    tree = {
        "search_space": s.space.name,
        "metric": s.objective.metric,
        "direction": s.objective.direction,
        "preset": s.preset,
        "fidelity": s.fidelity,
        "flown_by": command,
        "revisions": sorted(
            {
                str(tree.get("revision", "unknown"))
                for tree in recorded([t.record.directory for t in campaign.trials()])
            }
        ),
        "rocks": list(s.rocks),
        "paths": list(s.space.paths),
    }
    rows = [
        json.dumps([s.rocks.index(t.rock), t.replicate, t.raw, [t.values[path] for path in s.space.paths]])
        for t in campaign.trials()
    ]
    head = json.dumps(tree, indent=1).removesuffix("\n}")
    path = DIRECTORY / f"{s.space.name}.json"
    path.write_text(head + ',\n "missions": [\n  ' + ",\n  ".join(rows) + "\n ]\n}\n")
    print(f"{path}: {len(rows)} missions")


if __name__ == "__main__":
    main()
