"""Reads YAML, JSON and NPZ files of a limited size, which hold plain values only, and writes files whole.

YAML is read by the core schema of YAML 1.2: ``no``, ``12:30`` and dates are texts. ruamel.yaml 0.19 does not do that: it reads ``1_000``,
``0b11`` and dates as values, and needs five times as long as PyYAML's C loader.
"""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import uuid
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, ClassVar

import msgspec
import numpy as np
import yaml

from nbv.errors import UserError

MIB = 2**20
LIMITS_VARIABLE = "GATETUNE_LIMITS"  # a factor on every limit
TEXT_BYTES = 1 * MIB
RESULT_BYTES = 64 * MIB
NPZ_BYTES = 256 * MIB
TREE_DEPTH = 40  # of YAML: some thousand levels end the process in the C loader
_SafeLoader: type[Any] = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

# What a plain scalar is by YAML 1.2's core schema (section 10.3.2), and the characters that it may begin with. Merge keys (`<<`) are
# kept of YAML 1.1, as other readers of 1.2 do. A number with underscores is one by 1.1 and a text by 1.2, so it is refused.
_UNDERSCORES = "tag:yaml.org,2002:underscores"
_CORE_SCHEMA = {
    "null": (r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    "bool": (r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    "int": (r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+", list("-+0123456789")),
    "float": (
        r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)",
        list("-+.0123456789"),
    ),
    "merge": ("<<", ["<"]),
    "underscores": (
        r"(?=.*_)[-+]?\.?[0-9][0-9_]*(?:\.[0-9_]*)?(?:[eE][-+]?[0-9_]+)?",
        list("-+.0123456789"),
    ),
}
_CORE_TAGS = [f"tag:yaml.org,2002:{kind}" for kind in ("null", "bool", "float", "str", "seq")]


class CoreLoader(_SafeLoader):  # type: ignore[misc]
    """SafeLoader with YAML 1.2's core schema and no other kinds of values; a key given twice is refused."""

    yaml_implicit_resolvers: ClassVar[dict[str, Any]] = {}
    yaml_constructors: ClassVar[dict[str | None, Any]] = {
        tag: _SafeLoader.yaml_constructors[tag] for tag in _CORE_TAGS
    }


class CoreDumper(yaml.SafeDumper):
    """SafeDumper that also quotes what is a text in YAML 1.1 and none in 1.2, such as ``1e-6``, and writes no ``&id001``."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


for _kind, (_pattern, _first) in _CORE_SCHEMA.items():
    for _class in (CoreLoader, CoreDumper):
        _class.add_implicit_resolver(f"tag:yaml.org,2002:{_kind}", re.compile(f"(?:{_pattern})\\Z"), _first)


class _RefusedError(yaml.constructor.ConstructorError):
    """What is YAML and is not read, with its remedy."""

    def __init__(self, problem: str, node: yaml.Node) -> None:
        super().__init__(None, None, problem, node.start_mark)


def _whole_number(loader: Any, node: yaml.ScalarNode) -> int:
    text = loader.construct_scalar(node)
    number = int(text, 0 if text[:2] in ("0o", "0x") else 10)  # 010 is ten; PyYAML reads octal
    if not -(2**63) <= number < 2**63:
        raise _RefusedError("a whole number beyond 64 bits; give a smaller one", node)
    return number


def _unique_mapping(loader: Any, node: yaml.MappingNode) -> dict[str, Any]:
    seen: set[str] = set()
    for key_node, value in node.value:
        if key_node.tag == "tag:yaml.org,2002:merge":
            if isinstance(value, yaml.ScalarNode):
                problem = "the key << takes in another mapping (<<: *NAME), and no mapping follows"
                raise _RefusedError(problem, key_node)
            continue
        key = loader.construct_object(key_node, deep=True)
        if not isinstance(key, str):
            raise _RefusedError(f"the key {str(key)[:40]} is not a text; quote it", key_node)
        if key in seen:
            raise _RefusedError(f"duplicate key {key!r}; leave one out", key_node)
        seen.add(key)
    mapping: dict[str, Any] = loader.construct_mapping(node, deep=True)
    return mapping


def _no_number(loader: Any, node: yaml.ScalarNode) -> Any:
    number = node.value.replace("_", "")
    problem = f"{node.value} is a number in YAML 1.1 and a text in 1.2; write {number}, or quote it"
    raise _RefusedError(problem, node)


def _no_plain_value(loader: Any, node: yaml.Node) -> Any:
    tag = node.tag.replace("tag:yaml.org,2002:", "!!")[:40]
    raise _RefusedError(f"the tag {tag} is not read; give a plain value without it", node)


CoreLoader.add_constructor("tag:yaml.org,2002:map", _unique_mapping)
CoreLoader.add_constructor("tag:yaml.org,2002:int", _whole_number)
# << that is no key is a text.
CoreLoader.add_constructor("tag:yaml.org,2002:merge", _SafeLoader.construct_scalar)
CoreLoader.add_constructor(_UNDERSCORES, _no_number)
CoreLoader.add_constructor(None, _no_plain_value)


def require(count: float, limit: float, what: str) -> None:
    """`UserError` where ``count`` is beyond ``limit``; ``what`` reads on as "... is 7".

    ``GATETUNE_LIMITS=10`` in the environment raises all limits tenfold.
    """
    try:
        factor = float(os.environ.get(LIMITS_VARIABLE) or 1.0)
    except ValueError as error:
        raise UserError(f"{LIMITS_VARIABLE} must be a number such as 10") from error
    if not count <= limit * factor:
        raise UserError(
            f"{what} is {count:g}; the limit is {limit * factor:g} ({LIMITS_VARIABLE}=10 raises limits tenfold)"
        )


def expanded(path: str | Path) -> Path:
    """``path`` with ``~`` for the user's folder; `UserError` for ``~NAME`` of an unknown user."""
    try:
        return Path(path).expanduser()
    except RuntimeError as error:
        raise UserError(f"there is no home folder for {str(path)!r}; give a path without ~") from error


def is_file(path: Path) -> bool:
    """Whether a file lies there; False for what cannot be a path, such as too long a name."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def read_bytes(path: Path, limit_bytes: int = TEXT_BYTES) -> bytes:
    """The content of a file; `UserError` where it cannot be read, or is too large."""
    try:
        require(path.stat().st_size, limit_bytes, f"the size of {path} in bytes")
        return path.read_bytes()
    except FileNotFoundError as error:
        raise UserError(f"cannot read {path}: it does not exist") from error
    except (OSError, ValueError) as error:  # ValueError: a name that cannot be a path
        raise UserError(f"cannot read {path}: {getattr(error, 'strerror', None) or error}") from error


def read_text(path: Path, limit_bytes: int = TEXT_BYTES) -> str:
    """The content of a UTF-8 file; as `read_bytes`."""
    try:
        return read_bytes(path, limit_bytes).decode("utf-8")
    except UnicodeDecodeError as error:
        raise UserError(f"cannot read {path}: not UTF-8 ({error.reason} at byte {error.start})") from error


def write_atomic(path: Path, content: str | bytes | memoryview) -> None:
    """Write so that a reader, or a crash, sees the old file or the new one, never a part."""
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}.tmp")
    try:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


def require_whole(path: Path) -> None:
    """Raise ``OSError`` where a full disk, or a limit, cut what a compiled library has just written: most say nothing of it."""
    with path.open("ab") as file:
        size = file.tell()
        file.write(b"\0")
        file.flush()
        file.truncate(size)


def remove(path: Path) -> None:
    """Take away a file, or a folder with what is in it; nothing where there is nothing."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def parse_yaml(text: str, source: str) -> Any:
    """The tree in ``text`` by YAML 1.2's core schema; keys given twice are refused.

    `UserError`, which names ``source``, for what is not YAML, is too large, or holds values that are not plain.
    """
    require(len(text), TEXT_BYTES, f"the size of {source} in characters")
    try:
        depth = 0
        for event in yaml.parse(text, Loader=_SafeLoader):
            if isinstance(event, yaml.CollectionStartEvent):
                depth += 1
                require(depth, TREE_DEPTH, f"{source}: the depth")
            elif isinstance(event, yaml.CollectionEndEvent):
                depth -= 1
        return yaml.load(text, Loader=CoreLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f" line {mark.line + 1}" if mark is not None else ""
        remedy = "" if isinstance(error, _RefusedError) else "; correct the YAML"
        raise UserError(f"{source}{line}: {error.problem or error.context}{remedy}") from error
    except (yaml.YAMLError, ValueError, RecursionError, KeyError) as error:  # KeyError: `!!bool x`
        raise UserError(f"{source}: not YAML ({_first_line(error)}); correct it") from error


def to_yaml(tree: Any, **style: Any) -> str:
    """``tree`` as YAML that readers of 1.1 and of 1.2 read alike; ``style`` as `yaml.dump` has it."""
    return str(yaml.dump(tree, Dumper=CoreDumper, sort_keys=False, **style))


def read_yaml(path: Path) -> Any:
    """The tree in a YAML file; errors as `read_bytes` and `parse_yaml`."""
    return parse_yaml(read_text(path), str(path))


def parse_json(text: str, source: str, *, finite: bool = False) -> Any:
    """The tree in ``text``, which messages call ``source``; `UserError` for what is not JSON.

    ``finite`` refuses NaN and Infinity, which Python reads and JSON does not have.
    """

    def refuse(name: str) -> float:
        raise UserError(f"{source} holds {name}; every number must be finite, a missing one is left out")

    try:
        return json.loads(text, parse_constant=refuse if finite else None)
    except (ValueError, RecursionError) as error:
        raise UserError(f"{source} is not valid JSON: {_first_line(error)}") from error


def read_json(path: Path, limit_bytes: int = TEXT_BYTES) -> Any:
    """The tree in a JSON file; errors as `read_bytes` and `parse_json`."""
    return parse_json(read_text(path, limit_bytes), str(path))


def json_ready(value: Any) -> Any:
    """``value`` with non-finite numbers as None, numpy scalars as plain ones, dataclasses as dicts, paths as text, at any depth."""
    return msgspec.json.decode(msgspec.json.encode(value, enc_hook=_plain))


def _plain(value: Any) -> Any:
    if isinstance(value, Path):
        return str(value)
    if getattr(value, "ndim", None) == 0:  # numpy scalar
        return value.item()
    raise TypeError(f"{type(value).__name__} has no form in JSON")


def read_npz(path: Path, names: Iterable[str]) -> Mapping[str, np.ndarray]:
    """The arrays of an ``.npz`` file that have these names, none of objects.

    `UserError` as `read_bytes`, and for what is not an archive or lacks an array.
    """
    packed = read_bytes(path, NPZ_BYTES)
    try:
        with np.load(io.BytesIO(packed), allow_pickle=False) as archive:
            return {name: archive[name] for name in names}
    except Exception as error:  # zipfile, zlib and NumPy each raise families of their own on damaged bytes
        raise UserError(f"{path} is damaged or of another kind: {_first_line(error)}") from error


def _first_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
