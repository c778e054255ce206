"""Reads untrusted text, YAML, JSON and NPZ files within limits, and writes files safely.

Only regular files are read (a pipe would hang), up to a number of bytes. Trees hold plain values, with limits on depth and
number of nodes; a YAML alias counts as all that it stands for. ruamel.yaml 0.19 does not do that: it reads ``1_000``, ``0b11`` and
dates as values, takes ``!!binary`` and aliases without a limit, and needs five times as long as PyYAML's C loader. Arrays have the types and shapes that the caller asks for.

A run directory may be untrusted, too, and an archive may contain links: `require_plain` refuses all but files and folders, and
`open_to_write`, through which everything is written, follows no link.
"""

from __future__ import annotations

import contextlib
import errno
import io
import json
import os
import re
import shutil
import stat
import uuid
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO, ClassVar

import numpy as np
import yaml

from nbv.errors import UserError

MIB = 2**20
LIMITS_VARIABLE = "GATETUNE_LIMITS"  # a factor on every limit below
TEXT_BYTES = 1 * MIB
RESULT_BYTES = 64 * MIB
NPZ_BYTES = 256 * MIB  # unpacked
TREE_NODES = 50_000
RESULT_NODES = 5_000_000
TREE_DEPTH = 40
RUN_FILES = ("campaign.yaml", "evaluation.yaml")  # each lies in the root of a run directory
JOURNAL_LOCK = "study.journal.lock"  # Optuna makes a link, which is never followed
_INT_BOUND = 2**63
# Control characters but tab and newline, and marks that change the direction of writing.
_STEERING = {
    n: ascii(chr(n))[1:-1]
    for n in (*range(9), *range(11, 32), *range(127, 160), *range(0x202A, 0x202F), *range(0x2066, 0x206A))
}
_SafeLoader: type[Any] = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


# What a plain scalar is by YAML 1.2's core schema (section 10.3.2), and the characters that it may begin with: `no`, `on`,
# `1_000`, `12:30` and dates are texts. Merge keys (`<<`) are kept of YAML 1.1, as other readers of 1.2 do.
_CORE_SCHEMA = {
    "null": (r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    "bool": (r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    "int": (r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+", list("-+0123456789")),
    "float": (
        r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)",
        list("-+.0123456789"),
    ),
    "merge": ("<<", ["<"]),
}


_CORE_TAGS = {f"tag:yaml.org,2002:{kind}" for kind in ("null", "bool", "int", "float", "str", "seq", "map")}


class CoreLoader(_SafeLoader):  # type: ignore[misc]
    """SafeLoader with YAML 1.2's core schema that refuses a key given twice, where YAML would keep the last one silently."""

    yaml_implicit_resolvers: ClassVar[dict[str, Any]] = {}


class CoreDumper(yaml.SafeDumper):
    """SafeDumper that also quotes what is a text in YAML 1.1 and none in 1.2, such as ``1e-6``, and writes no ``&id001``."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


for _kind, (_pattern, _first) in _CORE_SCHEMA.items():
    for _class in (CoreLoader, CoreDumper):
        _class.add_implicit_resolver(f"tag:yaml.org,2002:{_kind}", re.compile(f"(?:{_pattern})\\Z"), _first)


def _whole_number(loader: Any, node: yaml.ScalarNode) -> int:
    text = loader.construct_scalar(node)
    return int(text, 0 if text[:2] in ("0o", "0x") else 10)  # 010 is ten; PyYAML reads octal


def _unique_mapping(loader: Any, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
    seen: set[Any] = set()
    for key_node, value in node.value:
        if key_node.tag == "tag:yaml.org,2002:merge":
            if isinstance(value, yaml.ScalarNode):
                problem = "the key << takes in another mapping (<<: *NAME), and no mapping follows"
                raise yaml.constructor.ConstructorError(None, None, problem, key_node.start_mark)
            continue
        key = loader.construct_object(key_node, deep=True)
        if isinstance(key, (list, dict)):
            continue
        if key in seen:
            raise yaml.constructor.ConstructorError(None, None, f"duplicate key {key!r}", key_node.start_mark)
        seen.add(key)
    mapping: dict[Any, Any] = loader.construct_mapping(node, deep=True)
    return mapping


CoreLoader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _unique_mapping)
CoreLoader.add_constructor("tag:yaml.org,2002:int", _whole_number)
CoreLoader.add_constructor(
    "tag:yaml.org,2002:merge", _SafeLoader.construct_scalar
)  # << that is no key is a text


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
    """Whether a regular file lies there; False for what cannot be a path, such as too long a name."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def read_bytes(path: Path, limit_bytes: int = TEXT_BYTES, *, follow: bool = True) -> bytes:
    """The content of a regular file; ``follow``: or of the one that a link leads to.

    `UserError` where it cannot be read, is no regular file, or is too large.
    """
    try:
        # Without blocking: opening a pipe would wait for a writer.
        flags = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | (0 if follow else os.O_NOFOLLOW)
        descriptor = os.open(path, flags)
        with os.fdopen(descriptor, "rb") as file:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode):
                raise UserError(f"{path} is not a regular file; name a file")
            require(status.st_size, limit_bytes, f"the size of {path} in bytes")
            return file.read()
    except FileNotFoundError as error:
        raise UserError(f"cannot read {path}: it does not exist") from error
    except (OSError, ValueError) as error:
        if not follow and getattr(error, "errno", None) == errno.ELOOP:
            raise _not_plain(path, link=True) from error
        raise UserError(f"cannot read {path}: {getattr(error, 'strerror', None) or error}") from error


def read_text(path: Path, limit_bytes: int = TEXT_BYTES, *, follow: bool = True) -> str:
    """The content of a UTF-8 file; as `read_bytes`."""
    try:
        return read_bytes(path, limit_bytes, follow=follow).decode("utf-8")
    except UnicodeDecodeError as error:
        raise UserError(f"cannot read {path}: not UTF-8 ({error.reason} at byte {error.start})") from error


def require_plain(folder: Path, depth: int) -> None:
    """Raise `UserError` where ``folder`` holds a link, a pipe or a device, in itself or in what lies less than ``depth`` below.

    Nor may one lead to ``folder`` from the run directory in which it lies; to that one a link of the user's may lead.
    """
    below = [folder.absolute()]
    for parent in below[0].parents[:4]:
        if any(os.path.lexists(parent / name) for name in RUN_FILES):
            for path in below:
                if path.is_symlink():
                    raise _not_plain(path, link=True)
        below.append(parent)
    _require_plain(folder, depth)


def _require_plain(folder: Path, depth: int) -> None:
    try:
        entries = list(os.scandir(folder))
    except OSError:  # whoever reads it says so
        return
    for entry in entries:
        if entry.is_dir(follow_symlinks=False):
            if depth > 1:
                _require_plain(Path(entry.path), depth - 1)
        elif (
            entry.name != JOURNAL_LOCK
            and not entry.is_file(follow_symlinks=False)
            and os.path.lexists(entry.path)
        ):
            raise _not_plain(Path(entry.path), link=entry.is_symlink())


def _not_plain(path: Path, *, link: bool) -> UserError:
    if link:
        return UserError(f"{path} is a link, which is not followed; take it away, or put a copy there")
    return UserError(f"{path} is neither a file nor a folder; take it away")


def open_to_write(path: str | Path, how: int = os.O_EXCL, folder: int | None = None) -> BinaryIO:
    """Open a file to write that no link leads away from; nothing else in the program opens one.

    ``how``: ``O_EXCL`` makes a new file, ``O_APPEND`` adds to one that may be there, 0 leaves it as it is. With ``folder``, the descriptor
    of a folder, ``path`` is a name in it. `UserError` where there is a link, or something else that is no file.
    """
    # Without blocking: opening a pipe would wait for a reader.
    flags = os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK | how
    try:
        descriptor = os.open(path, flags, 0o666, dir_fd=folder)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.ENXIO):
            raise _not_plain(Path(path), link=error.errno == errno.ELOOP) from error
        raise
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise _not_plain(Path(path), link=False)
    return os.fdopen(descriptor, "ab" if how & os.O_APPEND else "wb")


def write_atomic(path: Path, content: str | bytes | memoryview) -> None:
    """Write so that a reader, or a crash, sees the old file or the new one, never a part; a link there is replaced."""
    temporary = f".{path.name}.{uuid.uuid4().hex}.tmp"
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        with open_to_write(temporary, folder=folder) as file:
            file.write(content.encode() if isinstance(content, str) else content)
        os.replace(temporary, path.name, src_dir_fd=folder, dst_dir_fd=folder)
    except OSError:
        with contextlib.suppress(OSError):
            os.unlink(temporary, dir_fd=folder)
        raise
    finally:
        os.close(folder)


def require_whole(path: Path) -> None:
    """Raise ``OSError`` where a full disk, or a limit, cut what a compiled library has just written: most say nothing of it."""
    with path.open("ab") as file:
        size = file.tell()
        file.write(b"\0")
        file.flush()
        file.truncate(size)


def remove(path: Path) -> None:
    """Take away a file, a link itself, or a folder with what is in it; nothing where there is nothing."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def remove_links(folder: Path) -> None:
    """Remove, at any depth, links, devices and files with further hard links: writing there then changes no file elsewhere."""
    if folder.is_symlink():
        raise _not_plain(folder, link=True)
    for below, _, _ in os.walk(folder):
        for entry in os.scandir(below):
            status = entry.stat(follow_symlinks=False)
            alone = stat.S_ISREG(status.st_mode) and status.st_nlink == 1
            if not alone and not stat.S_ISDIR(status.st_mode):
                Path(entry.path).unlink(missing_ok=True)


def parse_yaml(text: str, source: str) -> Any:
    """The tree in ``text`` by YAML 1.2's core schema; keys given twice are refused.

    `UserError`, which names ``source``, for what is not YAML, beyond a limit, or holds values that are not plain, such as dates.
    """
    require(len(text), TEXT_BYTES, f"the size of {source} in characters")
    try:
        _check_events(text, source)
        tree = yaml.load(text, Loader=CoreLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f" line {mark.line + 1}" if mark is not None else ""
        raise UserError(f"{source}{line}: {error.problem or error.context}; correct the YAML") from error
    except (yaml.YAMLError, ValueError, OverflowError, RecursionError, KeyError) as error:
        raise UserError(f"{source}: not YAML ({_first_line(error)}); correct it") from error
    _check_tree(tree, source, TREE_NODES)
    return tree


def to_yaml(tree: Any, **style: Any) -> str:
    """``tree`` as YAML that readers of 1.1 and of 1.2 read alike; ``style`` as `yaml.dump` has it."""
    return str(yaml.dump(tree, Dumper=CoreDumper, sort_keys=False, **style))


def printable(text: str) -> str:
    r"""``text`` with what would steer a terminal, or turn a line's direction, as ``\x1b`` and so on."""
    return text.translate(_STEERING)


def read_yaml(path: Path) -> Any:
    """The tree in a YAML file; errors as `read_bytes` and `parse_yaml`."""
    return parse_yaml(read_text(path), str(path))


def parse_json(text: str, source: str, nodes: int = TREE_NODES, *, finite: bool = False) -> Any:
    """The tree in ``text``, which messages call ``source``, of at most so many ``nodes``.

    ``finite`` refuses NaN and Infinity, which Python reads and JSON does not have. `UserError` for what is not JSON, or beyond a limit.
    """

    def refuse(name: str) -> float:
        raise UserError(f"{source} holds {name}; every number must be finite, a missing one is left out")

    try:
        tree = json.loads(text, parse_constant=refuse if finite else None)
    except (ValueError, RecursionError) as error:
        raise UserError(f"{source} is not valid JSON: {_first_line(error)}") from error
    _check_tree(tree, source, nodes)
    return tree


def read_json(path: Path, limit_bytes: int = TEXT_BYTES, nodes: int = TREE_NODES) -> Any:
    """The tree in a JSON file; errors as `read_bytes` and `parse_json`."""
    return parse_json(read_text(path, limit_bytes), str(path), nodes)


def read_npz(path: Path, layout: Mapping[str, str]) -> dict[str, np.ndarray]:
    """The arrays of an ``.npz`` file, each as ``layout`` has it (`misfit`).

    `UserError` as `read_bytes`, and for what is not an archive, an array that is missing or of another kind, or beyond a limit.
    """
    packed = read_bytes(path, NPZ_BYTES)
    try:
        with zipfile.ZipFile(io.BytesIO(packed)) as archive:
            unpacked = sum(archive.getinfo(f"{name}.npy").file_size for name in layout)
        require(unpacked, NPZ_BYTES, f"the unpacked size of {path} in bytes")
        with np.load(io.BytesIO(packed), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in layout}
    except UserError:
        raise
    except MemoryError as error:
        raise UserError(f"{path} needs more memory than there is") from error
    except Exception as error:  # zipfile, zlib and NumPy each raise families of their own on damaged bytes
        raise UserError(f"{path} is damaged or of another kind: {_first_line(error)}") from error
    if name := misfit(arrays, layout):
        raise UserError(f"{path} is damaged or of another kind: {name} does not fit")
    return arrays


def misfit(arrays: Mapping[str, np.ndarray], layout: Mapping[str, str]) -> str:
    """The first of ``arrays`` that is not as ``layout`` has it; "" where all are.

    ``"f n 3"`` are floats (NumPy's letters of kinds) of shape (n, 3), n being the same wherever it is named; ``_`` is any
    length. ``"iu m 3 <n"`` are whole numbers from 0 to n - 1.
    """
    lengths: dict[str, int] = {}
    for name, text in layout.items():
        if not _has_shape(arrays[name], text, lengths):
            return name
    return next((name for name, text in layout.items() if not _is_below(arrays[name], text, lengths)), "")


def _has_shape(array: np.ndarray, text: str, lengths: dict[str, int]) -> bool:
    kinds, *dimensions = text.partition("<")[0].split()
    if array.dtype.kind not in kinds or array.ndim != len(dimensions):
        return False
    for dimension, length in zip(dimensions, array.shape, strict=True):
        expected = int(dimension) if dimension.isdigit() else lengths.setdefault(dimension, length)
        if dimension != "_" and length != expected:
            return False
    return True


def _is_below(array: np.ndarray, text: str, lengths: dict[str, int]) -> bool:
    bound = text.partition("<")[2]
    return not bound or array.size == 0 or (array.min() >= 0 and int(array.max()) < lengths[bound])


def _check_events(text: str, source: str) -> None:
    """Limits on depth and nodes with what aliases stand for, before anything is built."""
    sizes: dict[str, int] = {}
    levels: list[tuple[str | None, int]] = [(None, 0)]

    def add(count: int) -> None:
        anchor, size = levels[-1]
        require(size + count, TREE_NODES, f"{source}: the number of nodes")
        levels[-1] = (anchor, size + count)

    for event in yaml.parse(text, Loader=_SafeLoader):
        tag = getattr(event, "tag", None) or "!"
        if tag != "!" and tag not in _CORE_TAGS:
            named = tag.replace("tag:yaml.org,2002:", "!!")[:40]
            line = f" line {event.start_mark.line + 1}" if event.start_mark is not None else ""
            raise UserError(f"{source}{line}: the tag {named} is not read; give a plain value without it")
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in sizes:
                raise UserError(
                    f"{source}: alias *{event.anchor} refers to nothing, or to itself; correct it"
                )
            add(sizes[event.anchor])
        elif isinstance(event, yaml.ScalarEvent):
            add(1)
            if event.anchor:
                sizes[event.anchor] = 1
        elif isinstance(event, yaml.CollectionStartEvent):
            levels.append((event.anchor, 1))
            require(len(levels) - 1, TREE_DEPTH, f"{source}: the depth")
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, size = levels.pop()
            if anchor:
                sizes[anchor] = size
            add(size)


def _check_tree(tree: Any, source: str, nodes: int) -> None:
    level, depth, count = [tree], 0, 0
    while level:
        count += len(level)
        below: list[Any] = []
        for node in level:
            if node is None or isinstance(node, float):
                continue
            if isinstance(node, str):
                if not node.isascii() and any("\ud800" <= c <= "\udfff" for c in node):
                    raise UserError(f"{source}: half of a surrogate pair in {node[:40]!a}; take it out")
            elif isinstance(node, int):
                if not -_INT_BOUND <= node < _INT_BOUND:
                    raise UserError(f"{source}: a whole number beyond 64 bits; give a smaller one")
            elif isinstance(node, (dict, list)):
                if depth >= TREE_DEPTH:
                    require(depth + 1, TREE_DEPTH, f"{source}: the depth")
                below += node
                if isinstance(node, dict):
                    if (odd := next((key for key in node if not isinstance(key, str)), "")) != "":
                        raise UserError(f"{source}: the key {str(odd)[:40]} is not a text; quote it")
                    below += node.values()
            else:
                kind = type(node).__name__
                raise UserError(
                    f"{source}: {str(node)[:40]!r} is a {kind}, not a plain value; quote it if it is a text"
                )
        level, depth = below, depth + 1
    require(count, nodes, f"{source}: the number of nodes")


def _first_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
