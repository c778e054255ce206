"""Pictures of page, viewer and terminal for the documents: python docs/make_screenshots.py

Flies a small campaign with photographs in a temporary folder (a few minutes) and takes pictures in headless Chromium. Each
picture holds a digest of the files that decide how what it shows looks; a test compares it. After a change of those
that does not show, ``--same`` renews the digests alone.
"""

from __future__ import annotations

import argparse
import hashlib
import html
import io
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from PIL.PngImagePlugin import PngInfo

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs" / "images"
TEMPLATES = "tuner/report/templates"
MADE_FROM = {  # picture: what decides how it looks
    "campaign_page": [
        f"{TEMPLATES}/{name}" for name in ("campaign.html.j2", "macros.html.j2", "page.html.j2")
    ],
    "mission_view": [f"{TEMPLATES}/{name}" for name in ("walk.html.j2", "walk.js")],
    "terminal": ["tuner/commands/campaign_display.py", "tuner/report/comparison.py"],
}
DIGEST = "made from"  # the text in a picture that holds the digest
CAMPAIGN = "campaign run --quick --name tune"
LINES, WIDTH = 58, 80
TERMINAL = (
    "<meta charset=utf-8><body style='margin:0;background:#12161b;color:#e6e6e6'><pre style='margin:18px;"
    'font:15px/1.35 "DejaVu Sans Mono",monospace\'>{}</pre>'
)
OPTIONS = ["--headless", "--no-sandbox", "--hide-scrollbars"]
GRAPHICS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def digest(name: str) -> str:
    """Of the files that a picture is made from."""
    found = hashlib.sha256()
    for file in MADE_FROM[name]:
        found.update((ROOT / file).read_bytes())
    return found.hexdigest()[:16]


def save(image: Image.Image, name: str) -> None:
    """With few colours, so that the file stays small, and the digest."""
    notes = PngInfo()
    notes.add_text(DIGEST, digest(name))
    buffer = io.BytesIO()
    image.save(buffer, "PNG", optimize=True, pnginfo=notes)
    (IMAGES / f"{name}.png").write_bytes(buffer.getvalue())
    print(f"wrote {IMAGES / name}.png ({len(buffer.getvalue()) / 1000:.0f} kB)")


def photograph(address: str, size: tuple[int, int], name: str, colours: int = 64, wait_s: int = 5) -> None:
    """Photograph a page."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        sys.exit("needs Chromium: apt-get install chromium")
    with tempfile.TemporaryDirectory() as folder:
        picture = Path(folder) / "page.png"
        command = [chromium, *OPTIONS, *GRAPHICS, f"--virtual-time-budget={1000 * wait_s}"]
        command += [f"--window-size={size[0]},{size[1]}", f"--screenshot={picture}", address]
        subprocess.run(command, check=True, capture_output=True, timeout=300)
        image = Image.open(picture).convert("RGB").quantize(colours, Image.Quantize.MAXCOVERAGE)
    save(image, name)


def gatetune(words: list[str], folder: Path) -> str:
    """What the command says on standard output, without a terminal."""
    command = [sys.executable, "-m", "tuner.cli", *words]
    environment = {**os.environ, "COLUMNS": str(WIDTH)}
    return subprocess.run(
        command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True, check=True
    ).stdout


def photograph_terminal(said: str, words: list[str], folder: Path) -> None:
    """What a command answered, without the lines before it."""
    lines = said.splitlines()
    first = next((i for i, line in enumerate(lines) if line.startswith("Fly ")), len(lines) - LINES)
    shown = [f"$ gatetune {' '.join(words[:2])} ...", *lines[first:]]
    page = folder / "terminal.html"
    page.write_text(TERMINAL.format(html.escape("\n".join(shown))))
    photograph(page.as_uri(), (800, 24 + 21 * (len(shown) + 1)), "terminal")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--run", type=Path, help="A finished campaign with missions kept whole: fly none.")
    parser.add_argument("--only", choices=list(MADE_FROM), help="This picture alone; needs --run.")
    parser.add_argument("--same", action="store_true", help="What is shown looks as before: new digests.")
    arguments = parser.parse_args()
    if arguments.same:
        for name in MADE_FROM:
            save(Image.open(IMAGES / f"{name}.png"), name)
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        words = CAMPAIGN.split()
        if arguments.run:
            words = ["campaign", "status", str(arguments.run)]
        said = gatetune(words, Path.cwd() if arguments.run else folder)
        run = arguments.run.resolve() if arguments.run else folder / "runs" / "tune"
        pictures = {
            "campaign_page": lambda: photograph(
                (run / "report.html").as_uri(), (1200, 1750), "campaign_page"
            ),
            "mission_view": lambda: photograph(
                f"{(run / 'shown' / 'view.html').as_uri()}", (1300, 820), "mission_view", 224
            ),
            "terminal": lambda: photograph_terminal(said, words, folder),
        }
        for name in [arguments.only] if arguments.only else MADE_FROM:
            pictures[name]()


if __name__ == "__main__":
    main()
