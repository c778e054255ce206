"""The first hour of a new user, step by step on a mesh of their own: how long each takes, and the longest silence.

    python -m research.first_hour --out /tmp/first-hour [--fidelity geometric] [--budget 8] [--pipe]

Every step runs in a terminal of its own (80 columns), or into a pipe, with an empty store. A silence is the time without a
character; the bar redraws itself, so it ends where nothing moves. Three demands: the first mission on screen within 30 s
of the set-up's end, the first page within 6 minutes of it, no silence above 5 s. The processor's seconds, of all processes
of a step, are given too: on a machine that does other work they tell what the step itself took.
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
from dataclasses import astuple, dataclass, fields
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
    after: str  # the last line before that silence
    first_mission_s: float | None
    cpu_s: float
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


def step(name: str, command: list[str], folder: Path, environment: dict[str, str], *, pipe: bool) -> Step:
    """Run a command in a terminal, or into a pipe, and watch it."""
    print(f"{name}: gatetune {' '.join(command)}", flush=True)
    heard, spoken = os.pipe() if pipe else pty.openpty()
    if not pipe:
        ioctl(spoken, TIOCSWINSZ, struct.pack("HHHH", 40, 80, 0, 0))
    began = last = time.monotonic()
    used = os.times()
    process = subprocess.Popen(
        [sys.executable, "-m", "tuner.cli", *command],
        stdout=spoken,
        stderr=spoken,
        cwd=folder,
        env=environment,
    )
    os.close(spoken)
    seen, after, first, mission, silence = b"", "", None, None, 0.0
    while True:
        ready, _, _ = select.select([heard], [], [], 0.2)
        now = time.monotonic()
        if now - last > silence:
            silence, after = now - last, last_line(seen)
        if not ready:
            continue
        try:
            chunk = os.read(heard, 65536)
        except OSError:  # the terminal is closed
            break
        if not chunk:
            break
        seen, last = seen + chunk, now
        first = now - began if first is None else first
        if mission is None and re.search(rb"#001 ", seen):
            mission = now - began
    code = process.wait()
    os.close(heard)
    (folder / f"{name.replace(' ', '-')}.log").write_bytes(seen)
    cpu_s = sum(os.times()[2:4]) - sum(used[2:4])  # of children that have been waited for
    return Step(name, time.monotonic() - began, first or 0.0, silence, after, mission, cpu_s, code)


def last_line(seen: bytes) -> str:
    """The last line with a word in it, without what moves the cursor."""
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", seen.decode(errors="replace"))
    lines = [line.strip() for line in re.split(r"[\r\n]", text) if re.search(r"\w", line)]
    return lines[-1] if lines else "nothing"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--fidelity", default="photogrammetric")
    parser.add_argument("--budget", type=int, default=8)
    parser.add_argument("--pipe", action="store_true", help="Into a pipe instead of a terminal.")
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
    steps = [step(name, command, folder, environment, pipe=arguments.pipe) for name, command in plan]
    with (folder / "first_hour.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(field.name for field in fields(Step))
        for s in steps:
            writer.writerow(f"{v:.1f}" if isinstance(v, float) else v for v in astuple(s))
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
