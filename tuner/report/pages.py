"""Rendering of pages: jinja2 templates that ship with the package."""

from __future__ import annotations

import functools
import re
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup, escape

from nbv.errors import UserError
from nbv.safe_files import write_atomic


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
    return environment


def code(text: str) -> Markup:
    """Text in which `words in backticks` become code, numbers stay with their units, the rest is escaped."""
    text = re.sub(r"(?<=\d) (?=(%|mm|m|points|s|min|h)\b|%)", "\u00a0", text)
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text))))


def write_page(path: Path, template: str, **facts: Any) -> Path:
    """Render ``template`` into ``path``, atomically.

    Raises
    ------
    UserError
        The file cannot be written.
    """
    text = _environment().get_template(template).render(**facts)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, text)
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}; choose another directory") from error
    return path


def duration(seconds: float) -> str:
    """``4980`` as ``1 h 23 min``."""
    if seconds < 90:
        return f"{seconds:.0f} s" if seconds >= 10 or seconds == 0 else f"{seconds:.1f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"
