"""Parts that other packages bring: scorers, gates, renderers, dense backends, metrics, samplers, fidelities and families.

An installed package names them as entry points of the groups ``gatetune.GROUP``; `register` adds one in this process. Nothing
is imported before its name is asked for. What a part returns is checked, and what it is given is read-only.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import importlib
import importlib.util
import pkgutil
import sys
import traceback
import uuid
from collections.abc import Collection
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from nbv.errors import MissionFailure, UserError
from nbv.types import GateDecision

# What one part of each group is called, and what it must have, in the words of Python.
GROUPS: dict[str, tuple[str, tuple[str, ...]]] = {
    "scorers": ("scorer", ("main_term", "weights", "rank")),
    "gates": ("gate", ("decide", "retargeted")),
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
    """One part: its name, its object reference, and which distribution brought it."""

    group: str
    name: str
    reference: str  # "module:attribute"
    distribution: str = ""  # empty: registered in this process
    version: str = ""
    part: Any = field(default=None, repr=False)  # where it was registered
    asked: str = ""  # what `use` is told in another process; empty: it is installed, or cannot be brought

    @property
    def origin(self) -> str:
        """``mine 0.1.0``, or what registered it: a module, or ``NAME=COMMAND``."""
        if self.distribution:
            return f"{self.distribution} {self.version}"
        return self.asked if "=" in self.asked else self.reference.partition(":")[0]

    @property
    def label(self) -> str:
        """``scorer 'mine' of mine 0.1.0``."""
        return f"{GROUPS[self.group][0]} {self.name!r} of {self.origin}"

    @property
    def top_module(self) -> str:
        """The package, or the module, that it is in."""
        return self.reference.partition(":")[0].partition(".")[0]

    @functools.cached_property
    def source(self) -> str:
        """Digest of the Python files of its package, or of its module, and of the command of a program.

        Of what was typed into a notebook, which has none, another in every process.
        """
        top = self.top_module
        module = sys.modules[top] if top == "__main__" else importlib.util.find_spec(top)
        roots = getattr(module, "submodule_search_locations", None) or ()
        files = [file for root in roots for file in sorted(Path(root).rglob("*.py"))]
        if not files and (file := getattr(module, "origin", None) or getattr(module, "__file__", None)):
            files = [Path(file)]
        hasher = hashlib.sha256(getattr(self.part, "identity", "").encode())
        for file in files:
            hasher.update(file.read_bytes() if file.is_file() else b"")
        return hasher.hexdigest()[:32] if files else uuid.uuid4().hex

    @property
    def facts(self) -> dict[str, str]:
        """For the provenance."""
        return {"distribution": self.distribution, "version": self.version, "source": self.source}

    @functools.cached_property
    def loaded(self) -> Any:
        """The part; what a scorer or gate returns is checked. ``UserError`` where it cannot be imported or lacks its group's interface."""
        part = self.part
        if part is None:
            try:
                part = pkgutil.resolve_name(self.reference)
            except Exception as error:  # whatever another package raises
                raise UserError(
                    f"{self.label} cannot be imported ({type(error).__name__}: {error})"
                ) from error
        _require_interface(self, part)
        _used[self.group, self.name] = self
        guard = {"scorers": _guarded_scorer, "gates": _guarded_gate}.get(self.group)
        return guard(self, part) if guard else part


_registered: dict[tuple[str, str], Plugin] = {}
_used: dict[tuple[str, str], Plugin] = {}


def register(group: str, name: str, part: Any, asked: str | None = None) -> None:
    """Add a part in this process. Workers import the module that calls this.

    ``group`` is one of `GROUPS`; ``name`` is how configurations, search spaces and commands name the part; ``part`` is what an entry
    point would name, such as a `nbv.scorers.Scorer` or a subclass of `nbv.gates.Gate`; ``asked`` is what `use` is told in a worker, by
    default the module that calls. `UserError` where there is no such group, the part is none of it, or another module has
    registered the name.
    """
    if group not in GROUPS:
        raise UserError(f"there is no group {group!r} of plug-ins; there are {', '.join(GROUPS)}")
    caller = sys._getframe(1).f_globals
    module, file = str(caller.get("__name__")), str(caller.get("__file__") or "")
    if asked is None:
        asked = "" if module == "__main__" else module if "." in module or not file else file
    plugin = Plugin(group, name, f"{module}:{name}", part=part, asked=asked)
    earlier = _registered.get((group, name))
    if earlier is not None and (earlier.reference, earlier.asked) != (plugin.reference, plugin.asked):
        raise UserError(f"two {group} are called {name!r}: {earlier.label} and {plugin.label}; rename one")
    _require_interface(plugin, part)
    _registered[group, name] = plugin
    _used.pop((group, name), None)


def use(text: str) -> None:
    """Import what registers parts: a module, a file ``FOLDER/module.py``, or ``NAME=COMMAND``, a planner in another process.

    `UserError` where it cannot be imported, or registers nothing.
    """
    name, equals, command = text.partition("=")
    if equals:
        importlib.import_module("nbv.gates.external").register_program(name, command)
        return
    file = Path(text).expanduser()
    if file.suffix == ".py":
        if not file.is_file():
            raise UserError(f"--plugin {text}: there is no such file")
        folder = str(file.resolve().parent)
        if folder not in sys.path:
            sys.path.append(folder)  # last: what lies beside it hides nothing
        text = file.stem
    already, before = text in sys.modules, len(_registered)
    try:
        module = importlib.import_module(text)
    except UserError:  # of what it registers
        raise
    except Exception as error:  # whatever another's module raises
        raise UserError(f"plug-in {text} cannot be imported ({type(error).__name__}: {error})") from error
    if file.suffix == ".py" and not (module.__file__ and file.samefile(module.__file__)):
        raise UserError(
            f"plug-in {file}: another module is called {text} ({module.__file__}); rename the file"
        )
    of_installed = (plugin.top_module for group in GROUPS for plugin in installed(group))
    if not already and len(_registered) == before and text.partition(".")[0] not in of_installed:
        raise UserError(f"plug-in {text} registers nothing; call nbv.plugins.register in it")


def asked() -> list[str]:
    """What `use` must be told in a worker.

    `UserError` where a part was registered in a script or notebook itself, which no worker can import.
    """
    for plugin in _registered.values():
        if not plugin.asked:
            raise UserError(
                f"{GROUPS[plugin.group][0]} {plugin.name!r} was registered in a script or notebook itself, which workers "
                "cannot import; write it to a module of its own and import that"
            )
    return list(dict.fromkeys(plugin.asked for plugin in _registered.values()))


def modules() -> list[str]:
    """`asked`, and the modules of what this process has loaded: what a server imports before it forks."""
    return list(
        dict.fromkeys([*asked(), *(p.reference.partition(":")[0] for p in _used.values() if not p.asked)])
    )


def used() -> dict[str, dict[str, str]]:
    """Distribution, version and source digest of what this process has loaded, by ``group/name``."""
    return {f"{group}/{name}": plugin.facts for (group, name), plugin in sorted(_used.items())}


def plugins(group: str) -> dict[str, Plugin]:
    """The parts of a group by name, those registered in this process first.

    `UserError` where two have one name.
    """
    found = {name: plugin for (of, name), plugin in _registered.items() if of == group}
    for plugin in installed(group):
        earlier = found.setdefault(plugin.name, plugin)
        if earlier is not plugin and earlier.reference != plugin.reference:
            raise UserError(
                f"two {group} are called {plugin.name!r}: {earlier.label} and {plugin.label}; rename or uninstall one"
            )
    return found


def beside(own: Collection[str], group: str) -> dict[str, Plugin]:
    """The plug-ins of a group; `UserError` where one has the name of a built-in part (``own``)."""
    found = plugins(group)
    for taken in own & found.keys():
        raise UserError(f"{found[taken].label} has the name of one that is built in; rename or uninstall it")
    return found


def sources(group: str, *names: str) -> list[str]:
    """Source digests of the plug-ins among ``names``, for the cache keys of what they compute."""
    found = plugins(group)
    return [found[name].source for name in names if name in found]


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


def _require_interface(plugin: Plugin, part: Any) -> None:
    what, members = GROUPS[plugin.group]
    found = {name: getattr(part, name, None) for name in members}
    lacks = [name for name, own in found.items() if own is None or hasattr(own, "__isabstractmethod__")]
    if lacks:
        kind = "a class" if isinstance(part, type) else "an object"
        raise UserError(f"{plugin.label} is no {what}: {kind} without {', '.join(lacks)} (docs/extend.md)")
    settings = getattr(part, "settings", None)
    if plugin.group in CONFIGURED and settings is not None and not dataclasses.is_dataclass(settings):
        raise UserError(f"{plugin.label}: its settings must be a frozen dataclass (docs/extend.md)")


# -- what guards a part's calls -------------------------------------------------------------------


def read_only(value: Any) -> Any:
    """A read-only view of an array, or of all arrays in a dataclass or dictionary; memory is shared."""
    if isinstance(value, np.ndarray):
        view = value.view()
        view.flags.writeable = False
        return view
    if type(value) is dict:
        return {name: read_only(own) for name, own in value.items()}
    if not dataclasses.is_dataclass(value) or isinstance(value, type):
        return value
    fields = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    return dataclasses.replace(value, **{name: read_only(own) for name, own in fields.items()})


def failure_of(error: Exception) -> MissionFailure | None:
    """How a mission ends in which a plug-in's code raised ``error``; None where none of it was running."""
    lines = {
        str(frame.f_globals.get("__name__")).partition(".")[
            0
        ]: f"{Path(frame.f_code.co_filename).name}, line {line}"
        for frame, line in traceback.walk_tb(error.__traceback__)
    }
    lines.pop("nbv", None)
    plugin = next((p for p in _used.values() if p.top_module in lines), None)
    if plugin is None:
        return None
    hint = "; a plug-in must not change what it is given" if "read-only" in str(error) else ""
    said = " ".join(f"{type(error).__name__}: {error}".split())
    where = lines[plugin.top_module]
    return MissionFailure("plugin_failed", f"plug-in {plugin.origin} raised {said} ({where}){hint}")


def _require_numbers(plugin: Plugin, values: Any, count: int) -> Any:
    """``values`` as (count,) finite numbers; else the mission fails."""
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (count,):
        raise MissionFailure(
            "plugin_failed",
            f"{plugin.label} returned the shape {array.shape}, not ({count},): one number for each candidate",
        )
    if not np.isfinite(array).all():
        bad = int(np.count_nonzero(~np.isfinite(array)))
        raise MissionFailure("plugin_failed", f"{plugin.label} returned NaN or infinity for {bad} of {count}")
    return array


def _guarded_scorer(plugin: Plugin, scorer: Any) -> Any:
    def main_term(terms: Any, pool: Any, config: Any) -> Any:
        values = scorer.main_term(read_only(terms), read_only(pool), config)
        return _require_numbers(plugin, values, len(pool))

    return dataclasses.replace(scorer, name=plugin.name, main_term=main_term)


def _guarded_gate(plugin: Plugin, gate: Any) -> Any:
    def decide(self: Any, state: Any, pool: Any, rankings: Any) -> Any:
        decision = gate.decide(self, read_only(state), read_only(pool), rankings)
        if not isinstance(decision, GateDecision):
            said = f"{plugin.label} returned {type(decision).__name__}, no nbv.types.GateDecision"
            raise MissionFailure("plugin_failed", said)
        _require_numbers(plugin, decision.ranking.scores, len(pool))
        if not np.array_equal(np.sort(decision.ranking.order), np.arange(len(pool))):
            raise MissionFailure("plugin_failed", f"{plugin.label} returned an order that is no permutation")
        return decision

    return type(gate.__name__, (gate,), {"decide": decide, "__module__": gate.__module__})
