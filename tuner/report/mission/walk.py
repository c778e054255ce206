"""One page in which one, or two missions beside each other, can be walked around in."""

from __future__ import annotations

import importlib.resources
import json
from collections.abc import Sequence
from pathlib import Path

from markupsafe import Markup

from nbv.errors import UserError
from tuner.report.mission.walk_data import walk_of
from tuner.report.pages import write_page


def write_mission_view(runs: Sequence[Path], out: Path, rock: str | None = None) -> Path:
    """Write one HTML file, ``out``, that needs no server and no network: rock, clouds, cameras, pool, path, capture by capture.

    ``runs``: the directories of one or two missions that were flown with everything kept; ``rock``: catalogue name or mesh
    file, by default the catalogue's rock of the mission's name for it.

    Raises
    ------
    UserError
        A file is missing, a rock is not the one that was flown, or ``out`` cannot be written.
    """
    if not 1 <= len(runs) <= 2:
        raise UserError(f"{len(runs)} missions do not fit beside each other; name one or two")
    walks = [walk_of(run, rock) for run in runs]
    script = importlib.resources.files("tuner.report").joinpath("templates", "walk.js").read_text()
    title = " beside ".join(f"mission {walk['name']}" for walk in walks)
    data = json.dumps(walks, allow_nan=False).replace("<", "\\u003c")  # nothing in it can end the element
    return write_page(out, "walk.html.j2", title=title, data=Markup(data), script=Markup(script))
