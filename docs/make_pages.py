"""Make the pages and pictures of the documentation that follow from the code.

    python docs/make_pages.py            # write them
    python docs/make_pages.py --check    # exit 1 and name those that are not current

``reference/commands.md`` comes from the declarations of the command line and of a campaign's settings,
``reference/parameters.md`` from the configuration's, ``internals/rooms_*.svg`` from the imports.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import networkx as nx

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS.parent))  # this checkout, wherever it is run from

COMMAND_ORDER = (
    "campaign",
    "evaluate",
    "compare",
    "confirm",
    "reproduce",
    "export",
    "mission",
    "rocks",
    "photographs",
    "plugin",
    "config",
    "doctor",
)
LEFT_OUT = ("sparse", "dense", "evaluation")  # sections of which the page says only where they are listed
WIDTH, ROW, BOX_HEIGHT, GAP = 760, 74, 40, 14


def commands_page() -> str:
    """Every command of ``gatetune`` and what it does, and the settings of a campaign, as Markdown."""
    import typer

    from tuner.cli import app

    leaves = dict(_leaves(typer.main.get_command(app), ()))
    lines = [
        "# Commands",
        "",
        "`gatetune COMMAND --help` lists the options of a command and shows an example. `--out` says where a result is written; "
        "`--json` prints it as JSON, of a running campaign one object for each event.",
        "",
        "|command|what it does|",
        "|-|-|",
    ]
    for path, command in sorted(leaves.items(), key=lambda leaf: COMMAND_ORDER.index(leaf[0][0])):
        arguments = [p.name.upper() for p in command.params if p.param_type_name == "argument"]
        purpose = " ".join(command.help.split()).partition(" Example: ")[0]
        lines.append(f"|`{' '.join([*path, *arguments])}`|{purpose}|")
    options = [p for p in leaves["campaign", "run"].params if p.param_type_name == "option"]
    options = [p for p in options if p.name not in ("help", "out") and "--json" not in p.opts]
    lines += ["", "## Options of `gatetune campaign run`", ""]
    for panel in dict.fromkeys(p.rich_help_panel for p in options):
        lines += [f"**{panel}**", "", *(_option(p) for p in options if p.rich_help_panel == panel), ""]
    return "\n".join([*lines, *_settings_file()]).rstrip() + "\n"


def parameters_page() -> str:
    """Every parameter of a mission's configuration, section by section, as Markdown."""
    from nbv.config import parameters

    lines = [
        "# Parameters",
        "",
        "A parameter's path is its section and its name, which ends in its unit: `gate.d95_m`. `--set PATH=VALUE` changes it. "
        "Defaults are those of preset `paper`. `gatetune config show` prints the values of any preset, and where each comes "
        "from: the paper's text, the authors' public code, or gatetune. That command also lists the sections that are left out "
        "here: `sparse` (structure from motion), `dense` (stereo and fusion) and `evaluation` (cleaning and metrics).",
        "",
        *_presets_table(),
    ]
    lines += ["", "## Parameters by section", "", "|name|default|meaning|", "|-|-|-|"]
    section = ""
    for p in parameters().values():
        if (
            p.path in ("preset", "condition") or p.section in LEFT_OUT
        ):  # the names are set by files and options
            continue
        if p.section != section:
            section = p.section
            lines.append(f"|**{section}**|")
        choices = f" ({', '.join(f'`{c}`' for c in p.choices)})" if p.choices else ""
        value = _as_written(p.default) or "empty"
        name = p.path.removeprefix(f"{section}.")
        row = f"|`{name}`|{value}|{p.meaning}{choices}"
        if name.startswith("weights.") and row in lines:  # every scorer has its own of them
            row = "|`weights.*`|the same as of `covis`"
        if row != lines[-1]:
            lines.append(row)
    return "\n".join(lines) + "\n"


def _presets_table() -> list[str]:
    from nbv.config import PRESETS

    lines = ["## Presets", "", "|preset|purpose|differs from `paper` in|", "|-|-|-|"]
    for name, preset in PRESETS.items():
        sections: dict[str, list[str]] = {}
        base = PRESETS["campaign"].values if name in ("photographs", "campaign-reduced") else {}
        for path, value in preset.values.items():
            section, _, field = path.rpartition(".")
            if base.get(path) != value:
                sections.setdefault(section, []).append(f"`{field}` {_as_written(value)}")
        named = (f"**{section}** {', '.join(values)}" for section, values in sections.items())
        changes = "; ".join(text.removeprefix("**** ") for text in named)
        changes = f"as `campaign`, and {changes}" if base else changes or "nothing"
        lines.append(f"|`{name}`|{preset.purpose}|{changes}|")
    return lines


def _as_written(value: Any) -> str:
    """A value as a user writes it."""
    if value is None:
        return "unset"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_as_written, value))}]"
    return f"{value:g}" if isinstance(value, float) and float(f"{value:g}") == value else str(value)


def _settings_file() -> list[str]:
    """What a campaign's settings file may hold besides its options."""
    from tuner.campaign.settings_file import SETTINGS

    options = {name: s.option.split()[0] for name, s in SETTINGS.items() if s.option}
    renamed = (
        f"`{name}` (`{option}`)"
        for name, option in options.items()
        if option != f"--{name.replace('_', '-')}"
    )
    lines = [
        "## Settings file",
        "",
        "`gatetune campaign run settings.yaml` reads settings from a file, such as the `campaign.yaml` of another campaign; "
        "options of the command override it. Relative paths start at the file's folder.",
        "",
        "    rocks: [slab, scans/shale.obj]",
        "    overrides: {photographs: 20, seeds: 12}",
        "    objective: {metric: observable.c2c_mean_mm, direction: minimise}",
        "",
        f"Every option above is a field, except `--quick` and *Execution* other than `--keep`; {', '.join(renamed)} have other "
        "names there. Further fields and forms:",
        "",
    ]
    for name, s in SETTINGS.items():
        if s.option and s.in_file:
            lines.append(f"- `{name}`: {s.in_file}")
        elif not s.option:
            lines.append(f"- `{name}`: {s.text} (default: {s.default_text or 'none'})")
    return [*lines, ""]


def _leaves(command: Any, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
    if not hasattr(command, "commands"):
        yield path, command
        return
    for name, child in command.commands.items():
        yield from _leaves(child, (*path, name))


def _default(option: Any) -> str:
    if option.required:
        return ", required"
    default = option.default
    return "" if default is None or isinstance(default, bool) or callable(default) else f" ({default})"


def _option(option: Any) -> str:
    return f"- `{option.opts[0]}`{_default(option)}: {' '.join((option.help or '').split())}"


GROUND_FLOOR = ("errors", "plugins", "process", "provenance", "safe_files", "types")


def rooms(package: str) -> nx.DiGraph:
    """The rooms of a package and which imports which; a room's number of files is its ``files``.

    What all rooms of the mission stand on is one node, the ground floor.
    """
    from structure import imports, modules

    paths = modules(DOCS.parent)
    room_of = {}
    for name in paths:
        parts = name.split(".")
        if parts[0] == package and len(parts) > 1:
            below = package == "nbv" and parts[1] in GROUND_FLOOR
            room_of[name] = "ground floor" if below else parts[1]
    graph = nx.DiGraph()
    for room in room_of.values():
        graph.add_node(room)
        graph.nodes[room]["files"] = graph.nodes[room].get("files", 0) + 1
    for source, target in imports(DOCS.parent).edges:
        if source in room_of and target in room_of and room_of[source] != room_of[target]:
            graph.add_edge(room_of[source], room_of[target])
    return graph


def rooms_picture(package: str) -> str:
    """An SVG: every room on its floor, with an arrow to what it imports.

    An arrow that follows from others is left out. Floors count the longest way down.
    """
    graph = rooms(package)
    floor: dict[str, int] = {}
    for room in reversed(list(nx.lexicographical_topological_sort(graph))):
        floor[room] = 1 + max((floor[below] for below in graph.successors(room)), default=-1)
    arrows = nx.transitive_reduction(graph)
    rows: list[list[str]] = [[] for _ in range(max(floor.values()) + 1)]
    for room in sorted(graph.nodes):
        rows[floor[room]].append(room)
    x: dict[str, float] = {}
    for _ in range(
        4
    ):  # a few sweeps: a room above the middle of what it needs, below the middle of what needs it
        for row in rows:
            row.sort(key=lambda room: (_middle(room, arrows, x), room))
            for i, room in enumerate(row):
                x[room] = WIDTH * (i + 0.5) / len(row)
    height = ROW * len(rows)
    boxes, lines = [], []
    for room in sorted(graph.nodes):
        box_width = min(150.0, WIDTH / len(rows[floor[room]]) - GAP)
        top = ROW * (len(rows) - 1 - floor[room]) + 8
        files = graph.nodes[room]["files"]
        boxes.append(
            f'<rect x="{x[room] - box_width / 2:.1f}" y="{top}" width="{box_width:.1f}" height="{BOX_HEIGHT}" rx="6"/>'
            f'<text x="{x[room]:.1f}" y="{top + 17}">{escape(room)}</text>'
            f'<text class="files" x="{x[room]:.1f}" y="{top + 32}">{files} file{"s" * (files != 1)}</text>'
        )
        for below in sorted(arrows.successors(room)):
            end = ROW * (len(rows) - 1 - floor[below]) + 8
            start = top + BOX_HEIGHT
            lines.append(
                f'<path d="M{x[room]:.1f} {start}C{x[room]:.1f} {start + 22} {x[below]:.1f} {end - 26} '
                f'{x[below]:.1f} {end - 5}"/>'
            )
    style = (
        "rect{fill:#eef2fb;stroke:#3949ab}text{font:600 13px sans-serif;fill:#1a237e;text-anchor:middle}"
        ".files{font-weight:400;font-size:11px;fill:#555}path{fill:none;stroke:#8a93b8;marker-end:url(#a)}"
    )
    marker = (
        '<marker id="a" viewBox="0 0 8 8" refX="4" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<polygon points="0,0 8,4 0,8" fill="#8a93b8"/></marker>'
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}">\n<style>{style}</style>\n'
        f'<defs>{marker}</defs>\n<rect width="{WIDTH}" height="{height}" style="fill:#fff;stroke:none"/>\n'
        + "\n".join(lines + boxes)
        + "\n</svg>\n"
    )


def _middle(room: str, arrows: nx.DiGraph, x: dict[str, float]) -> float:
    known = [x[other] for other in (*arrows.successors(room), *arrows.predecessors(room)) if other in x]
    return sum(known) / len(known) if known else WIDTH / 2


def pages() -> dict[Path, str]:
    """Every made file's path below ``docs/`` and its text."""

    return {
        Path("reference/commands.md"): commands_page(),
        Path("reference/parameters.md"): parameters_page(),
        Path("internals/rooms_nbv.svg"): rooms_picture("nbv"),
        Path("internals/rooms_tuner.svg"): rooms_picture("tuner"),
    }


def main() -> int:
    """Write or check the made files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--check", action="store_true")
    check = parser.parse_args().check
    stale = []
    for path, text in pages().items():
        file = DOCS / path
        if file.is_file() and file.read_text() == text:
            continue
        stale.append(path)
        if not check:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text)
    for path in stale:
        print(f"{'not current' if check else 'written'}: docs/{path}")
    return 1 if check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
