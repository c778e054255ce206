"""Rendering of pages, jinja2 templates that ship with the package, and where their numbers come from."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup, escape

from nbv.errors import UserError
from nbv.mission.run_directory import read_result
from nbv.provenance import git_revision, versions
from nbv.safe_files import write_atomic
from tuner.report.labels import Table

MOST_READ = 200  # missions whose documents are read


@functools.cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("tuner.report", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["code"] = code
    environment.filters["unbroken"] = unbroken
    return environment


def code(text: str) -> Markup:
    """Text in which `words in backticks` become code, numbers stay with their units, the rest is escaped."""
    text = re.sub(r"(?<=\d) (?=(%|mm|m|points|s|min|h)\b|%)", "\u00a0", text)
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text))))


def unbroken(text: str) -> str:
    """Text whose intervals do not wrap: blanks beside numbers, signs and brackets become no-break spaces."""
    return re.sub(r"(?<=[\d,±]) (?=[-−+±\[\d%])", "\u00a0", text)


def write_page(path: Path, template: str, **facts: Any) -> Path:
    """Render ``template`` with ``facts`` and the program's version into ``path``, atomically.

    Raises `UserError`: the file cannot be written.
    """
    text = _environment().get_template(template).render(version=versions().get("gatetune", ""), **facts)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, text)
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}; choose another directory") from error
    return path


def write_tables(path: Path, heading: str, sub: str, *, tables: Sequence[Table], **facts: Any) -> Path:
    """Write a page of tables below what they say.

    ``facts``: ``lines``, its first line in bold, with its ``kind`` and ``measure``; ``notes``; ``failed``; a ``figure`` with its
    caption; the ``legend`` below the first table; ``folded`` tables, the first one perhaps ``open``; ``provenance``; ``command``.

    Raises `UserError`: the file cannot be written.
    """
    absent = dict.fromkeys(("kind", "measure", "figure", "folded_legend", "command", "footer"), "")
    empty = dict.fromkeys(("notes", "failed", "legend", "folded", "provenance"), ())
    page = {**absent, **empty, "open": False, **facts, "tables": tables, "heading": heading, "sub": sub}
    return write_page(path, "tables.html.j2", title=f"{heading} · gatetune", **page)


def recorded(missions: Sequence[Path]) -> list[dict[str, Any]]:
    """What the missions in these directories recorded, those that ended; of many every few."""
    trees = []
    for mission in missions[:: -(-len(missions) // MOST_READ) or 1]:
        try:
            tree = read_result(mission).get("provenance")
        except UserError:
            continue
        # A mission's file may be anybody's.
        if tree and isinstance(tree, dict) and isinstance(tree.get("versions", {}), dict):
            trees.append(tree)
    return trees


def recorded_rows(trees: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """Revisions, versions, machines and renderers, for a page."""
    software = trees[-1].get("versions", {}) if trees else versions()
    return [
        ("revision of the missions", _each(trees, "revision")),
        ("revision of this page", git_revision()),
        ("versions", ", ".join(f"{name} {number}" for name, number in software.items())),
        ("machine", _each(trees, "machine")),
        ("renderer", _each(trees, "backend")),
    ]


def _each(trees: Sequence[Mapping[str, Any]], key: str) -> str:
    return ", ".join(sorted({str(tree[key]) for tree in trees if key in tree})) or "not recorded"
