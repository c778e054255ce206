"""`python -m research.kills`: a comparison and a campaign of geometric missions, killed at random moments and begun again.

Each is run once without a fault. Then processes of the same command are killed with all that they started, after a time drawn from
what is left of it, until ``--kills`` have been met; the last goes on to the end. A mission that had ended before a kill and has
another end afterwards is *lost*, and tables that are not those of the run without a fault, byte for byte, are *other*.
"""

from __future__ import annotations

import argparse
import csv
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

COMMANDS = {
    "compare": "compare --strategy random --strategy orbit --strategy orbit-two --numbers 12:20:2 --targets 3 --workers 2",
    "campaign": "campaign run --fidelity geometric --sampler sobol --space gate --budget 10 --replicates 1 --rock boulder "
    "--rock slab --workers 2 --set photographs=28 --name kills --resume-if-present",
}
OF_THE_CLOCK = {"wall_s", "costs.wall_s", "finished", "started", "directory"}


def start(kind: str, run: Path) -> subprocess.Popen[bytes]:
    """The command, in a session of its own."""
    command = [sys.executable, "-m", "tuner.cli", *COMMANDS[kind].split(), "--out", str(run)]
    quiet = subprocess.DEVNULL
    return subprocess.Popen(command, stdout=quiet, stderr=quiet, start_new_session=True)


def ended(run: Path) -> dict[str, int]:
    """The missions that have ended, and when their outcome was written."""
    return {str(p.relative_to(run)): p.stat().st_mtime_ns for p in run.rglob("mission.json")}


def tables(kind: str, run: Path) -> dict[str, str]:
    """What a reader takes from it, without times of the clock."""
    if kind == "campaign":
        export = ["export", str(run), "--to", "csv", "--out", str(run / "missions.csv")]
        subprocess.run([sys.executable, "-m", "tuner.cli", *export], check=True, stdout=subprocess.DEVNULL)
    found = {}
    for path in sorted(run.rglob("*.csv")):
        rows = list(csv.DictReader(path.open(newline="")))
        kept = [{k: v for k, v in row.items() if k not in OF_THE_CLOCK} for row in rows]
        found[str(path.relative_to(run))] = str(kept)
    return found


def main() -> int:
    """Exit status 1 where something was lost or is another."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=20, help="of each command")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    harm = 0
    for kind in COMMANDS:
        rng, place = random.Random(f"{kind}:{given.seed}"), Path(tempfile.mkdtemp(prefix="kills-"))
        began = time.monotonic()
        assert start(kind, place / "whole").wait() == 0
        takes_s, whole = time.monotonic() - began, tables(kind, place / "whole")
        kills = lost = other = runs = 0
        while kills < given.kills:
            run, status = place / f"killed_{runs}", None
            while status is None:
                before, process = ended(run), start(kind, run)
                try:
                    limit_s = None if kills >= given.kills else rng.uniform(0.2, 0.6) * takes_s
                    status = process.wait(limit_s)
                except subprocess.TimeoutExpired:
                    os.killpg(process.pid, signal.SIGKILL)
                    process.wait()
                    kills += 1
                lost += sum(ended(run).get(name) != when for name, when in before.items())
            runs += 1
            other += status != 0 or tables(kind, run) != whole
        harm += lost + other
        print(f"{kind}: {kills} kills in {runs} runs, {lost} missions lost, {other} tables other", flush=True)
    return int(harm > 0)


if __name__ == "__main__":
    raise SystemExit(main())
