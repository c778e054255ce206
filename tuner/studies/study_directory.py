"""The settings file of a study's directory: written once, and the same when the study goes on."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from nbv.errors import UserError
from nbv.run_directory import write_atomic

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

FORMAT_VERSION = 1


def settings_tree(settings: DataclassInstance) -> dict[str, Any]:
    """YAML form of a flat dataclass of plain values, tuples and mappings."""
    tree = {f.name: getattr(settings, f.name) for f in dataclasses.fields(settings)}
    plain = {name: list(value) if isinstance(value, tuple) else value for name, value in tree.items()}
    return {"format": FORMAT_VERSION, **plain}


def load_settings(directory: Path, file_name: str, study: str) -> dict[str, Any]:
    """The fields that ``settings_tree`` wrote, lists as tuples.

    Raises
    ------
    UserError
        The file is missing, damaged or of another version.
    """
    path = directory / file_name
    if not path.is_file():
        raise UserError(f"{directory} holds no {study} ({file_name} is missing); name a study's directory")
    try:
        tree = yaml.safe_load(path.read_text())
        if tree.pop("format") != FORMAT_VERSION:
            raise UserError(f"{path} was written by another version; start a new study elsewhere")
        return {name: tuple(value) if isinstance(value, list) else value for name, value in tree.items()}
    except (OSError, yaml.YAMLError, KeyError, AttributeError) as error:
        raise UserError(f"{path} is not a study's settings ({error!r}); restore the file") from error


def claim(directory: Path, file_name: str, tree: dict[str, Any]) -> None:
    """Write a study's settings into a new directory, or find the same ones there.

    Raises
    ------
    UserError
        The directory holds something else or cannot be written.
    """
    path = directory / file_name
    if path.exists():
        try:
            known = yaml.safe_load(path.read_text())
        except (OSError, yaml.YAMLError) as error:
            raise UserError(f"cannot read {path} ({error}); restore it or choose another --out") from error
        if known != tree:
            raise UserError(f"{directory} holds another study; choose another --out")
        return
    if directory.exists() and (not directory.is_dir() or any(directory.iterdir())):
        raise UserError(f"{directory} exists and is not an empty directory; choose another --out")
    try:
        directory.mkdir(parents=True, exist_ok=True)
        write_atomic(path, yaml.safe_dump(tree, sort_keys=False))
    except OSError as error:
        raise UserError(f"cannot write to {directory}: {error.strerror}; choose another --out") from error
