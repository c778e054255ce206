"""The YAML around the keys: flat dictionaries in and out."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from nbv.errors import UserError
from nbv.safe_files import read_yaml
from tuner.bridges.photogrammetry_nbv.keys import FILES


def read_file(path: Path, kind: str) -> dict[str, Any]:
    """Return the values of one of their files, by dotted path; ``kind`` is a key of `FILES`.

    Raises
    ------
    UserError
        Not a readable file of that kind, or a key that nobody knows.
    """
    if not path.is_file():
        raise UserError(f"{path} is not a file; name a {kind} of photogrammetry_nbv")
    tree = read_yaml(path)
    prefix, keys = FILES[kind]
    for part in prefix:
        tree = tree.get(part) if isinstance(tree, dict) else None
    if not isinstance(tree, dict):
        raise UserError(f"{path} has no mapping {'/'.join(prefix)}; is it a {kind}?")
    values = _flat(tree, "", {key.path for key in keys})
    known = [key.path for key in keys]
    for name in values:
        if name not in known:
            near = difflib.get_close_matches(name, known, 1)
            hint = f"; did you mean {near[0]}?" if near else ""
            raise UserError(f"{path}: unknown key {name!r}{hint}")
    return values


def write_text(values: Mapping[str, Any], kind: str, header: str = "") -> str:
    """YAML text of one of their files from values by dotted path; ``header`` becomes comment lines."""
    prefix, _ = FILES[kind]
    tree: dict[str, Any] = {}
    for path, value in values.items():
        node = tree
        *parents, leaf = path.split(".")
        for parent in parents:
            node = node.setdefault(parent, {})
        node[leaf] = value
    for part in reversed(prefix):
        tree = {part: tree}
    comment = "".join(f"# {line}".rstrip() + "\n" for line in header.splitlines())
    return comment + yaml.safe_dump(tree, sort_keys=False, default_flow_style=None, width=100)


def _flat(tree: Mapping[Any, Any], prefix: str, known: set[str]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for name, value in tree.items():
        path = f"{prefix}{name}"
        if isinstance(value, dict) and path not in known:
            values |= _flat(value, f"{path}.", known)
        else:
            values[path] = value
    return values
