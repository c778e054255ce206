"""A picture of a page as a browser shows it: ``python docs/screenshot.py PAGE IMAGE [WIDTH HEIGHT]``; needs Chromium.

The viewer's picture: gatetune mission run --rock slab --out runs/first; gatetune mission view runs/first;
python docs/screenshot.py "runs/first/view.html#step=28" docs/images/mission_view.png
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

GRAPHICS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]


def main(page: str, image: str, width: str = "1200", height: str = "820") -> None:
    """Take it, and reduce it to 224 colours."""
    file, _, place = page.partition("#")
    with tempfile.TemporaryDirectory() as folder:
        shot = Path(folder) / "shot.png"
        options = ["--headless", "--hide-scrollbars", "--virtual-time-budget=6000", *GRAPHICS]
        address = f"{Path(file).resolve().as_uri()}#{place}"
        command = ["chromium", *options, f"--window-size={width},{height}", f"--screenshot={shot}", address]
        subprocess.run(command, check=True, capture_output=True, timeout=120)
        Image.open(shot).convert("RGB").quantize(224, Image.Quantize.MAXCOVERAGE).save(image, optimize=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
