"""JSON documents against the published schemas: one line for the first mistake."""

from __future__ import annotations

import functools
from importlib import resources
from typing import Any

import jsonschema

from nbv.errors import UserError
from nbv.safe_files import parse_json

KINDS = ("mission", "request", "result")


@functools.cache
def schema(kind: str) -> dict[str, Any]:
    """The published schema of ``mission``, ``request`` or ``result``."""
    text = resources.files(__package__).joinpath("schemas", f"{kind}.schema.json").read_text(encoding="utf-8")
    tree: dict[str, Any] = parse_json(text, f"schema {kind}")
    return tree


def check(tree: Any, kind: str, source: str) -> None:
    """`UserError`, one line that names ``source`` and the place, if ``tree`` does not fit; a newer version is named."""
    version = schema(kind)["properties"]["schema"]["const"]
    found = tree.get("schema") if isinstance(tree, dict) else None
    if isinstance(found, str) and found != version and found.startswith(version.partition("/")[0] + "/"):
        raise UserError(
            f"{source} has schema {found}; this version reads {version}: upgrade gatetune or the mission"
        )
    validator = jsonschema.Draft202012Validator(schema(kind))
    error = jsonschema.exceptions.best_match(validator.iter_errors(tree))
    if error is not None:
        place = ".".join(str(part) for part in error.absolute_path) or "the document"
        raise UserError(f"{source}: {place}: {_message(error)}")


def _message(error: Any) -> str:
    if isinstance(error.schema, dict) and "message" in error.schema:
        return (
            f"{error.instance!r} {error.schema['message']}"
            if isinstance(error.instance, str)
            else error.schema["message"]
        )
    alternatives = error.validator_value if error.validator in ("oneOf", "anyOf") else []
    if alternatives and all(set(alternative) == {"required"} for alternative in alternatives):
        keys = ["+".join(alternative["required"]) for alternative in alternatives]
        return f"needs {'either ' if error.validator == 'oneOf' else ''}{' or '.join(keys)}"
    return " ".join(error.message.split())[:200]
