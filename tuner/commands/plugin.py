"""``gatetune plugin list|init``."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import typer

from nbv import plugins
from nbv.config import MissionConfig
from nbv.errors import UserError
from tuner.commands.console import AsJson, answer_json, output, show_table
from tuner.problem.baselines import BASELINES

app = typer.Typer(no_args_is_help=True)
TEMPLATES = Path(__file__).with_name("plugin_package")


@app.command("list")
def list_(as_json: AsJson = False) -> None:
    """List the installed plug-ins and the distribution of each; none is imported.

    Example: gatetune plugin list
    """
    parts = [plugin for group in plugins.GROUPS for plugin in plugins.plugins(group).values()]
    rows = [(p.name, p.group, p.distribution or p.module, p.version) for p in parts]
    answer_json([dict(zip(("name", "group", "distribution", "version"), row)) for row in rows])
    if rows:
        show_table(("name", "group", "distribution", "version"), rows)
    else:
        output.print("no plug-in is installed; gatetune plugin init NAME writes one")


@app.command()
def init(
    name: Annotated[str, typer.Argument(help="Its name in configurations: small letters, digits, dashes.")],
    gate: Annotated[
        bool, typer.Option("--gate", help="A gate, which sees the whole state, instead of a scorer.")
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Its folder (default: ./NAME).")] = None,
) -> None:
    """Write a package with a scorer or gate of your own, with a README and a test that passes.

    Example: gatetune plugin init mine
    """
    folder, section = out or Path(name), name.replace("-", "_")
    if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", name):
        raise UserError(f"{name!r} cannot name a plug-in; use small letters, digits and single dashes")
    if name in BASELINES or hasattr(MissionConfig(), section):
        raise UserError(f"{name!r} is already the name of a strategy or section; choose another")
    if folder.exists():
        raise UserError(f"{folder} exists; choose another folder with --out")
    kind = "gate" if gate else "scorer"
    words = {"NAME": name, "MODULE": f"gatetune_{section}", "SECTION": section}
    words |= {"KIND": kind, "PART": "Planner" if gate else "PLANNER", "VERSION": str(plugins.INTERFACE)}

    def write(source: str, place: Path) -> None:
        text = (TEMPLATES / source).read_text()
        for word, value in words.items():
            text = text.replace(f"@{word}@", value)
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(text)

    write("pyproject.toml.txt", folder / "pyproject.toml")
    write("README.md.txt", folder / "README.md")
    write(f"{kind}.py.txt", folder / words["MODULE"] / "__init__.py")
    write("test.py.txt", folder / "tests" / f"test_{words['SECTION']}.py")
    output.print(f"{folder}: edit {words['MODULE']}/__init__.py, then pip install -e {folder}")
    output.print(f"to compare it with orbits (10 minutes) run the last command in {folder}/README.md")
