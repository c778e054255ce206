"""The settings file of a study's directory: written once, and the same when the study goes on."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import yaml

from nbv.errors import UserError
from nbv.mission.run_directory import write_atomic

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

FORMAT_VERSION = 2  # 1 named its mission runner by module and function
Settings = TypeVar("Settings")


def settings_tree(settings: DataclassInstance) -> dict[str, Any]:
    """YAML form of a flat dataclass of plain values, tuples and mappings."""
    tree = {f.name: getattr(settings, f.name) for f in dataclasses.fields(settings)}
    plain = {name: list(value) if isinstance(value, tuple) else value for name, value in tree.items()}
    return {"format": FORMAT_VERSION, **plain}


class StudySettings(Protocol):
    """What a study keeps in its settings file."""

    def to_dict(self) -> dict[str, Any]:
        """YAML form."""

    @staticmethod
    def load(directory: Path) -> StudySettings:
        """The settings of a study's directory; ``UserError`` if there are none."""


def load_settings(directory: Path, file_name: str, study: str, build: Callable[..., Settings]) -> Settings:
    """``build`` called with the fields that ``settings_tree`` wrote, lists as tuples.

    Raises
    ------
    UserError
        The file is missing, damaged, has a field that ``build`` does not know, or is of another version.
    """
    path = directory / file_name
    if not path.is_file():
        raise UserError(f"{directory} holds no {study} ({file_name} is missing); name a study's directory")
    try:
        tree = yaml.safe_load(path.read_text())
        if tree.pop("format") != FORMAT_VERSION:
            raise UserError(f"{path} was written by another version; start a new study elsewhere")
        fields = {name: tuple(value) if isinstance(value, list) else value for name, value in tree.items()}
        return build(**fields)
    except (OSError, yaml.YAMLError, KeyError, TypeError, AttributeError) as error:
        raise UserError(f"{path} is not a study's settings ({error!r}); restore the file") from error


def claim(settings: StudySettings, directory: Path, file_name: str, study: str) -> None:
    """Write a study's settings into a new directory, or find the same ones there.

    Raises
    ------
    UserError
        The directory holds something else or cannot be written.
    """
    path = directory / file_name
    if path.exists():
        if settings.load(directory).to_dict() != settings.to_dict():
            raise UserError(f"{directory} holds another {study}; choose another --out")
        return
    if directory.exists() and (not directory.is_dir() or any(directory.iterdir())):
        raise UserError(f"{directory} exists and is not an empty directory; choose another --out")
    try:
        directory.mkdir(parents=True, exist_ok=True)
        write_atomic(path, yaml.safe_dump(settings.to_dict(), sort_keys=False))
    except OSError as error:
        raise UserError(f"cannot write to {directory}: {error.strerror}; choose another --out") from error
