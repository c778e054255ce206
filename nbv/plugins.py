"""Parts that other packages bring: scorers, gates, renderers, dense backends, metrics, samplers, fidelities and families.

An installed package names its parts as entry points of the groups ``gatetune.GROUP``; `register` adds one in this process, as the file
or module does that ``--plugin`` names. Nothing is imported before its name is asked for. Plug-ins are code that the user trusts; no file
of a run says which is imported. This room lies below the configuration and knows no built-in part.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import importlib.util
import pkgutil
import sys
import traceback
import uuid
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

from nbv.errors import UserError

# What one part of each group is called, and what it must have, in the words of Python.
GROUPS: dict[str, tuple[str, tuple[str, ...]]] = {
    "scorers": ("scorer", ("main_term", "weights", "rank")),
    "gates": ("gate", ("decide", "recentred")),
    "renderers": ("renderer", ("rgb",)),
    "dense": ("dense backend", ("__call__",)),
    "metrics": ("metric", ("key", "measure")),
    "samplers": ("sampler", ("__call__",)),
    "fidelities": ("fidelity", ("__call__",)),
    "families": ("family", ("__call__",)),
}
INTERFACE = 1  # raised where what a part is given, or must return, changes
CONFIGURED = ("scorers", "gates", "renderers", "dense")  # groups whose parts may have settings of their own


@dataclass(frozen=True)
class Plugin:
    """One part that is not built in: its name, its object reference, and which distribution brought it."""

    group: str
    name: str
    reference: str  # "module:attribute"
    distribution: str = ""  # empty: registered in this process
    version: str = ""
    part: Any = field(default=None, repr=False)  # where it was registered
    spec: str = ""  # what ``--plugin`` names it by; empty: it is installed, or another process cannot have it
    rival: str = ""  # another of the same name

    @property
    def origin(self) -> str:
        """``mine 0.1.0``, or the module that registered it."""
        return f"{self.distribution} {self.version}" if self.distribution else self.module

    @property
    def label(self) -> str:
        """``scorer 'mine' of mine 0.1.0``."""
        return f"{GROUPS[self.group][0]} {self.name!r} of {self.origin}"

    @property
    def module(self) -> str:
        return self.reference.partition(":")[0]

    @functools.cached_property
    def source(self) -> str:
        """Digest of the Python files of its package, or of its module.

        Of what was typed into a notebook, which has none, another in every process.
        """
        package = self.module.partition(".")[0]
        module = sys.modules[package] if package == "__main__" else importlib.util.find_spec(package)
        roots = getattr(module, "submodule_search_locations", None) or ()
        files = [file for root in roots for file in sorted(Path(root).rglob("*.py"))]
        if not files and (file := getattr(module, "origin", None) or getattr(module, "__file__", None)):
            files = [Path(file)]
        hasher = hashlib.sha256()
        for file in files:
            hasher.update(file.read_bytes() if file.is_file() else b"")
        return hasher.hexdigest()[:32] if files else uuid.uuid4().hex

    @property
    def facts(self) -> dict[str, str]:
        return {"distribution": self.distribution, "version": self.version, "source": self.source}

    @property
    def loaded(self) -> Any:
        """The part; ``UserError`` where it cannot be imported or lacks its group's interface."""
        _used[self.group, self.name] = self
        return self._checked

    @functools.cached_property
    def _checked(self) -> Any:
        part = self.part
        if self.rival:
            raise UserError(
                f"two {self.group} are called {self.name!r}: {self.label} and {self.rival}; rename or uninstall one"
            )
        if part is None:
            with _one_line(self.label):
                part = pkgutil.resolve_name(self.reference)
        _require_interface(self, part)
        return part


class Registry(Collection[str]):
    """The parts of one group by name: those built in, then the plug-ins that have no built-in part's name.

    It knows names, so that a configuration is checked long before a mission runs. What loads the parts lies above it and says what
    the built-in ones are (`load`). ``reserved``: names besides that no plug-in may have.
    """

    def __init__(self, group: str, built_in: Collection[str], reserved: Collection[str] = ()) -> None:
        self.group, self.built_in, self.reserved = group, built_in, reserved

    def plugins(self) -> dict[str, Plugin]:
        """The plug-ins by name.

        An installed one with the name of a built-in part is left out, which `left_out` tells; `UserError` where it was registered.
        """
        brought = plugins(self.group)
        for name in [name for name in brought if name in self.built_in or name in self.reserved]:
            leave_out(brought.pop(name))
        return brought

    def plugin(self, name: str) -> Plugin | None:
        """The plug-in of that name; None where it is built in or nothing has it."""
        return self.plugins().get(name)

    def sources(self, *names: str) -> list[str]:
        """Source digests of the plug-ins among ``names``, for the cache keys of what they compute."""
        brought = self.plugins()
        used = [brought[name] for name in names if name in brought]
        _used.update({(plugin.group, plugin.name): plugin for plugin in used})
        return [plugin.source for plugin in used]

    def __contains__(self, name: object) -> bool:
        return name in self.built_in or name in self.plugins()

    def __iter__(self) -> Iterator[str]:
        return iter((*self.built_in, *self.plugins()))

    def __len__(self) -> int:
        return len(self.built_in) + len(self.plugins())

    def require(self, name: str) -> None:
        if name not in self:
            raise UserError(
                f"unknown {GROUPS[self.group][0]} {name!r}; there are {', '.join(self)}, or those of a plug-in "
                "that is installed or named with gatetune --plugin"
            )

    def load(self, name: str, built_in: Mapping[str, Any]) -> Any:
        """The part called ``name``: a plug-in's, or one of ``built_in``, parts or where they lie (``module:attribute``).

        `UserError`: the name is unknown, or a plug-in's part is not of the kind that its group asks for.
        """
        self.require(name)
        if (plugin := self.plugin(name)) is not None:
            return plugin.loaded
        part = built_in[name]
        return pkgutil.resolve_name(part) if isinstance(part, str) else part


_registered: dict[tuple[str, str], Plugin] = {}
_used: dict[tuple[str, str], Plugin] = {}
_left_out: dict[tuple[str, str], str] = {}


def register(group: str, name: str, part: Any) -> None:
    """Add a part in this process. Workers import the module that calls this.

    ``group`` is one of `GROUPS`; ``name`` is how configurations, search spaces and commands name the part; ``part`` is what an entry
    point would name, such as a `nbv.scorers.Scorer` or a subclass of `nbv.gates.Gate`. `UserError` where there is no such group, the
    part is none of it, or another module has registered the name.
    """
    if group not in GROUPS:
        raise UserError(f"there is no group {group!r} of plug-ins; there are {', '.join(GROUPS)}")
    caller = sys._getframe(1).f_globals
    module, file = str(caller.get("__name__")), str(caller.get("__file__") or "")
    spec = "" if module == "__main__" else module if "." in module or not file else file
    plugin = Plugin(group, name, f"{module}:{name}", part=part, spec=spec)
    earlier = _registered.get((group, name))
    if earlier is not None and (earlier.reference, earlier.spec) != (plugin.reference, plugin.spec):
        raise UserError(f"two {group} are called {name!r}: {earlier.label} and {plugin.label}; rename one")
    _require_interface(plugin, part)
    _registered[group, name] = plugin
    _used.pop((group, name), None)


def use(spec: str) -> None:
    """Import what registers parts: a module, or a file ``FOLDER/module.py``.

    `UserError` where it cannot be imported, or registers nothing.
    """
    file, name = Path(spec).expanduser(), spec
    if file.suffix == ".py":
        if not file.is_file():
            raise UserError(f"--plugin {spec}: there is no such file")
        folder = str(file.resolve().parent)
        if folder not in sys.path:
            sys.path.append(folder)  # last: what lies beside it hides nothing
        name = file.stem
    is_known, before = name in sys.modules, len(_registered)
    with _one_line(f"plug-in {name}"):
        module = importlib.import_module(name)
    if file.suffix == ".py" and not (module.__file__ and file.samefile(module.__file__)):
        raise UserError(
            f"plug-in {file}: another module is called {name} ({module.__file__}); rename the file"
        )
    if not is_known and len(_registered) == before:
        raise UserError(f"plug-in {name} registers nothing; call nbv.plugins.register in it")


def plugin_specs() -> list[str]:
    """What ``--plugin`` names in another process that is to have the parts of this one.

    `UserError` where a part was registered in a script or notebook itself, which no worker can import.
    """
    for plugin in _registered.values():
        if not plugin.spec:
            raise UserError(
                f"{GROUPS[plugin.group][0]} {plugin.name!r} was registered in a script or notebook itself, which workers "
                "cannot import; write it to a module of its own and import that"
            )
    return list(dict.fromkeys(plugin.spec for plugin in _registered.values()))


def used() -> dict[str, dict[str, dict[str, str]]]:
    """For the provenance, ``plugins``: distribution, version and source digest of what was used since `forget_used`, by ``group/name``."""
    facts = {f"{group}/{name}": plugin.facts for (group, name), plugin in sorted(_used.items())}
    return {"plugins": facts} if facts else {}


def forget_used() -> None:
    """Begin another mission in this process."""
    _used.clear()


def plugins(group: str) -> dict[str, Plugin]:
    """The parts of a group by name, those registered in this process first; what two share cannot be `Plugin.loaded`."""
    parts = {name: plugin for (of, name), plugin in _registered.items() if of == group}
    for plugin in installed(group):
        earlier = parts.setdefault(plugin.name, plugin)
        if earlier.reference != plugin.reference:
            parts[plugin.name] = dataclasses.replace(earlier, rival=plugin.label)
    return parts


def leave_out(plugin: Plugin) -> None:
    """Go on without an installed plug-in that has the name of a built-in part; `UserError` for a registered one."""
    line = f"{plugin.label} has the name of one that is built in"
    if not plugin.distribution:
        raise UserError(f"{line}; rename it")
    _left_out[plugin.group, plugin.name] = (
        f"{line} and is left out; rename it or uninstall {plugin.distribution}"
    )


def left_out() -> list[str]:
    """A line for each installed plug-in that was not taken."""
    return list(_left_out.values())


@functools.cache
def installed(group: str) -> tuple[Plugin, ...]:
    """What the entry points of installed distributions bring, which may repeat a name."""
    return tuple(
        Plugin(group, entry.name, entry.value, entry.dist.name, entry.dist.version)
        for entry in metadata.entry_points(group=f"gatetune.{group}")
        if entry.dist is not None
    )


def settings_class(section: str) -> type | None:
    """The class of the settings that a part called ``section`` declares, dashes as underscores; None where there is none."""
    parts = (part for group in CONFIGURED for part in plugins(group).values())
    named = next((part for part in parts if part.name.replace("-", "_") == section), None)
    return None if named is None else getattr(named.loaded, "settings", None)


@contextlib.contextmanager
def _one_line(label: str) -> Iterator[None]:
    """Turn what an import raises into a `UserError` that names the plug-in, and the file and line where it has one."""
    try:
        yield
    except UserError:  # of what it registers
        raise
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(last.filename).name}, line {last.lineno}"
        raise UserError(f"{label} cannot be imported: {type(error).__name__}: {error} ({where})") from error


def _require_interface(plugin: Plugin, part: Any) -> None:
    what, members = GROUPS[plugin.group]
    has = {name: getattr(part, name, None) for name in members}
    lacks = [
        name for name, member in has.items() if member is None or hasattr(member, "__isabstractmethod__")
    ]
    if lacks:
        kind = "a class" if isinstance(part, type) else "an object"
        raise UserError(f"{plugin.label} is no {what}: {kind} without {', '.join(lacks)} (docs/extend.md)")
    settings = getattr(part, "settings", None)
    if plugin.group in CONFIGURED and settings is not None and not dataclasses.is_dataclass(settings):
        raise UserError(f"{plugin.label}: its settings must be a frozen dataclass (docs/extend.md)")
