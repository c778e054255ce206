"""Pictures of the campaign's page and of the terminal for the documents: python docs/make_screenshots.py

Runs a small campaign of geometric missions in a temporary folder (a minute), photographs its page with headless
Chromium, and what the terminal said.
"""

from __future__ import annotations

import argparse
import html
import io
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

IMAGES = Path(__file__).resolve().parent / "images"
CAMPAIGN = (
    "campaign run --name mine --fidelity geometric --space gate_weights_and_pool --set stop.adaptive_budget=12 "
    "--rock slab --rock vesicular --rock cavern --budget 30 --learn-from nothing --workers 1"
)
LINES, WIDTH, COLOURS = 34, 80, 64
TERMINAL = (
    "<meta charset=utf-8><body style='margin:0;background:#12161b;color:#e6e6e6'><pre style='margin:18px;"
    'font:15px/1.35 "DejaVu Sans Mono",monospace\'>{}</pre>'
)


def photograph(page: Path, size: tuple[int, int], target: Path) -> None:
    """Photograph a local page; few colours, so that the file stays small."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        sys.exit("needs Chromium: apt-get install chromium")
    with tempfile.TemporaryDirectory() as folder:
        picture = Path(folder) / "page.png"
        command = [chromium, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
        command += ["--virtual-time-budget=4000", f"--window-size={size[0]},{size[1]}"]
        subprocess.run(
            [*command, f"--screenshot={picture}", page.resolve().as_uri()], check=True, capture_output=True
        )
        small = Image.open(picture).convert("RGB").quantize(COLOURS)
    buffer = io.BytesIO()
    small.save(buffer, "PNG", optimize=True)
    target.write_bytes(buffer.getvalue())
    print(f"wrote {target} ({len(buffer.getvalue()) / 1000:.0f} kB)")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--run", type=Path, help="A finished campaign's folder: fly none, and show its status."
    )
    given = parser.parse_args().run
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "COLUMNS": str(WIDTH)}
        words = ["campaign", "status", str(given.resolve())] if given else CAMPAIGN.split()
        said = subprocess.run(
            [sys.executable, "-m", "tuner.cli", *words],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        run = given or Path(folder) / "runs" / "mine"
        photograph(run / "report.html", (1200, 1750), IMAGES / "campaign_page.png")
        shown = [f"$ gatetune {' '.join(words[:2])} ...", *said.splitlines()[-LINES:]]
        terminal = Path(folder) / "terminal.html"
        terminal.write_text(TERMINAL.format(html.escape("\n".join(shown))))
        photograph(terminal, (800, 24 + 21 * (len(shown) + 1)), IMAGES / "terminal.png")


if __name__ == "__main__":
    main()
