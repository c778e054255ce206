"""`make faults`: real faults in running campaigns, and the ledger against an independent record of what finished.

A campaign of `faults_mission` is run by its command in a child process, met by faults of one kind, and run again until its
budget is used. Missions append to a record that the campaign never sees; afterwards every mission of the record must be in
the ledger with its value (else *lost*), none may have begun again after its end (*repeated*), and no trial may have ended
without one (*charged*). A session must end within a minute (else *hang*) and say so in one line (else *traceback*).
``--only KIND:NUMBER`` repeats a campaign's draws; the moments differ.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import os
import random
import shutil
import sys
import tempfile
import time
import traceback
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"  # before numpy is loaded: a process with threads cannot be forked

from research.fault_campaign import Flight, kill_all, of_campaign
from research.fault_kinds import KINDS, own_disk, possible

ROOT = Path(__file__).resolve().parents[1]
MOST_SESSIONS = 60
COLUMNS = (
    "faults",
    "campaigns",
    "went_on",
    "clean",
    "ended",
    "traceback",
    "hang",
    "lost",
    "repeated",
    "charged",
)


def fly_one(kind: str, number: int, most: int | None = None, *, small: bool = False) -> Flight:
    """One campaign with faults of a kind, to its end."""
    rng = random.Random(f"{kind}:{number}")
    place = Path(tempfile.mkdtemp(prefix="faults-"))
    os.environ["GATETUNE_HOME"] = str(HOME)
    with own_disk(place / "disk", kind) as disk:
        flight = Flight(place, disk / "run", rng, small=small, report=not small and number % 5 == 0)
        try:
            for _ in range(MOST_SESSIONS):
                if flight.done or (most is not None and flight.faults >= most):
                    break
                KINDS[kind](flight)
            flight.finish()
        except Exception:
            flight.count("traceback", traceback.format_exc())
        finally:
            kill_all(*of_campaign(flight.run))
    if not flight.told:
        shutil.rmtree(place)
    return flight


HOME = Path()


@contextlib.contextmanager
def prepared() -> Iterator[None]:
    """What every session would import is imported, and what it would make once is made."""
    global HOME
    if str(ROOT) not in sys.path:
        sys.path.insert(0, str(ROOT))
    with tempfile.TemporaryDirectory() as home:
        HOME = Path(home)
        import matplotlib.figure  # noqa: F401
        import torch  # noqa: F401

        import tuner.campaign.begin
        import tuner.campaign.session
        import tuner.campaign.settings_file
        import tuner.cli
        import tuner.report.campaign_page
        import tuner.surrogate.fit  # noqa: F401

        yield


def write_table(table: dict[str, Counter[str]], path: Path) -> None:
    """Rows of kinds, and a last one of all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["kind", *COLUMNS])
        for kind, counts in table.items():
            rows.writerow([kind, *(counts[c] for c in COLUMNS)])
        total = sum(table.values(), Counter())
        rows.writerow(["all", *(total[c] for c in COLUMNS)])


def main() -> int:
    """Exit status 1 where there is a finding."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=float(os.environ.get("MINUTES") or 5))
    parser.add_argument(
        "--count", type=int, default=int(os.environ.get("COUNT") or 0), help="faults, instead of a time"
    )
    parser.add_argument("--kind", action="append", choices=list(KINDS))
    parser.add_argument("--only", help="KIND:NUMBER: this campaign")
    parser.add_argument("--small", action="store_true", help="4 missions a campaign, never a report: a test")
    parser.add_argument("--first", type=int, default=0, help="number of the first campaigns")
    parser.add_argument("--out", type=Path, default=Path("runs") / "faults")
    given = parser.parse_args()
    kinds = [kind for kind in given.kind or KINDS if possible(kind)]
    table: dict[str, Counter[str]] = defaultdict(Counter)
    began = time.monotonic()

    def go_on() -> bool:
        if given.count:
            return sum(counts["faults"] for counts in table.values()) < given.count
        return time.monotonic() - began < 60 * given.minutes

    with prepared():
        if given.only:
            kind, _, number = given.only.rpartition(":")
            flight = fly_one(kind, int(number))
            print(flight.faults, dict(flight.verdicts), *flight.told, sep="\n")
            return int(bool(flight.told))
        number = given.first
        while go_on():
            for kind in kinds:
                if not go_on():
                    break
                flight = fly_one(kind, number, most=given.count or None, small=given.small)
                table[kind] += flight.verdicts + Counter(faults=flight.faults, campaigns=1)
                for told in flight.told:
                    print(f"{kind}:{number}: {told}", flush=True)
                write_table(table, given.out / "faults.csv")
            number += 1
    print((given.out / "faults.csv").read_text())
    return int(any(counts[c] for counts in table.values() for c in COLUMNS[5:]))


if __name__ == "__main__":
    raise SystemExit(main())
