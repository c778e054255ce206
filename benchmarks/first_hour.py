"""The first hour of a new user, step by step on a mesh of their own: how long each takes, and the longest silence.

    python benchmarks/first_hour.py --out /tmp/first-hour [--fidelity geometric] [--budget 8]

Every step runs in a terminal of its own (80 columns) with an empty store. A silence is the time without a character; the
bar redraws itself, so it ends where nothing moves. Three demands: the first mission on screen within 30 s of the set-up's
end, the first page within 6 minutes of it, no silence above 5 s.
"""

from __future__ import annotations

import argparse
import csv
import os
import pty
import re
import select
import shutil
import struct
import subprocess
import sys
import time
from dataclasses import dataclass
from fcntl import ioctl
from pathlib import Path
from termios import TIOCSWINSZ

import numpy as np
import trimesh

FIRST_MISSION_S, PAGE_S, SILENCE_S = 30.0, 360.0, 5.0


@dataclass(frozen=True)
class Step:
    """One command as it went."""

    name: str
    seconds: float
    first_output_s: float
    longest_silence_s: float
    first_mission_s: float | None
    exit_code: int


def own_mesh(path: Path) -> None:
    """A lump of 12 cm: a sphere with smooth bumps, as somebody might have scanned it."""
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=0.06)
    unit = mesh.vertices / 0.06
    bumps = sum(
        np.sin(k * unit @ axis + k) / k for k, axis in enumerate(np.eye(3)[[0, 1, 2, 0, 1, 2]] + 0.4, 2)
    )
    mesh.vertices = mesh.vertices * (1 + 0.25 * bumps)[:, None] * (1.0, 0.8, 0.7)
    mesh.export(path)


def step(name: str, command: list[str], folder: Path, environment: dict[str, str]) -> Step:
    """Run a command in a terminal and watch it."""
    print(f"{name}: gatetune {' '.join(command)}", flush=True)
    master, slave = pty.openpty()
    ioctl(slave, TIOCSWINSZ, struct.pack("HHHH", 40, 80, 0, 0))
    began = last = time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-m", "tuner.cli", *command], stdout=slave, stderr=slave, cwd=folder, env=environment
    )
    os.close(slave)
    seen, first, mission, silence = b"", None, None, 0.0
    while True:
        ready, _, _ = select.select([master], [], [], 0.2)
        now = time.monotonic()
        chunk = b""
        if ready:
            try:
                chunk = os.read(master, 65536)
            except OSError:  # the terminal is closed
                break
            if not chunk:
                break
        silence = max(silence, now - last)
        if chunk:
            seen, last = seen + chunk, now
            first = now - began if first is None else first
            if mission is None and re.search(rb"#001 ", seen):
                mission = now - began
    code = process.wait()
    os.close(master)
    (folder / f"{name.replace(' ', '-')}.log").write_bytes(seen)
    return Step(name, time.monotonic() - began, first or 0.0, silence, mission, code)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--fidelity", default="photogrammetric")
    parser.add_argument("--budget", type=int, default=8)
    arguments = parser.parse_args()
    folder = arguments.out.resolve()
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    environment = {**os.environ, "GATETUNE_HOME": str(folder / "home"), "COLUMNS": "80", "TERM": "xterm"}
    own_mesh(folder / "mine.obj")
    flown = ["--rock", "mine", "--fidelity", arguments.fidelity, "--budget", str(arguments.budget)]
    plan = [
        ("doctor", ["doctor"]),
        ("import", ["rocks", "import", "mine.obj", "--name", "mine"]),
        ("campaign", ["campaign", "run", "--name", "mine", *flown]),
        ("status", ["campaign", "status", "runs/mine"]),
        ("export", ["export", "runs/mine", "--to", "scoring.yaml"]),
    ]
    steps = [step(name, command, folder, environment) for name, command in plan]
    with (folder / "first_hour.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(
            ("step", "seconds", "first_output_s", "longest_silence_s", "first_mission_s", "exit_code")
        )
        for s in steps:
            mission = "" if s.first_mission_s is None else f"{s.first_mission_s:.1f}"
            row = (
                s.name,
                f"{s.seconds:.1f}",
                f"{s.first_output_s:.1f}",
                f"{s.longest_silence_s:.1f}",
                mission,
            )
            writer.writerow((*row, s.exit_code))
    print((folder / "first_hour.csv").read_text())
    campaign = next(s for s in steps if s.name == "campaign")
    page = (folder / "runs" / "mine" / "report.html").is_file()
    demands = (
        (
            f"first mission within {FIRST_MISSION_S:.0f} s",
            (campaign.first_mission_s or np.inf) <= FIRST_MISSION_S,
        ),
        (f"page within {PAGE_S:.0f} s", page and campaign.seconds <= PAGE_S),
        (f"no silence above {SILENCE_S:.0f} s", max(s.longest_silence_s for s in steps) <= SILENCE_S),
        ("scoring.yaml written", (folder / "runs" / "mine" / "scoring.yaml").is_file()),
    )
    for text, met in demands:
        print(f"{'met' if met else 'NOT MET'}: {text}")


if __name__ == "__main__":
    main()
