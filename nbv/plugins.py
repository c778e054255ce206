"""Parts that other packages bring: scorers, gates, renderers, dense backends, metrics, samplers, fidelities and families.

An installed package names them as entry points of the groups ``gatetune.GROUP``; `register` adds one in this process. Nothing
is imported before its name is asked for. What a part returns is checked, and what it is given is a read-only copy.
A part is somebody's unfinished code: it may end its own mission, and nothing else.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import functools
import hashlib
import importlib
import importlib.util
import os
import pkgutil
import select
import signal
import sys
import traceback
import uuid
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from nbv.errors import MissionFailure, UserError
from nbv.types import GateDecision, Ranking

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
PLANNERS = ("scorers", "gates")
IMPORT_S = 60.0  # a module that takes longer to import is refused
SAID_LETTERS = 300  # of what a part says, in a message
DETAILS_BYTES = 10_000  # of what a gate says of one decision
MOST_TERMS = 50  # of a ranking


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
    rival: str = ""  # another of the same name

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
    def file(self) -> str:
        """Name of the file that it is in; empty for a program, and where that has not been imported."""
        module = None if "=" in self.asked else sys.modules.get(self.reference.partition(":")[0])
        return Path(getattr(module, "__file__", None) or "").name

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
        if self.rival:
            raise UserError(
                f"two {self.group} are called {self.name!r}: {self.label} and {self.rival}; rename or uninstall one"
            )
        if part is None:
            module = _imported(self.reference.partition(":")[0], self.label)
            try:
                part = pkgutil.resolve_name(self.reference)
            except Exception as error:
                raise UserError(
                    f"{self.label} cannot be imported: {said(error)} ({module.__file__})"
                ) from error
        _require_interface(self, part)
        _used[self.group, self.name] = self
        guard = {"scorers": _guarded_scorer, "gates": _guarded_gate}.get(self.group)
        return guard(self, part) if guard else part


_registered: dict[tuple[str, str], Plugin] = {}
_used: dict[tuple[str, str], Plugin] = {}
_left_out: dict[tuple[str, str], str] = {}


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
    module = _imported(text, f"plug-in {text}")
    if file.suffix == ".py" and not (module.__file__ and file.samefile(module.__file__)):
        raise UserError(
            f"plug-in {file}: another module is called {text} ({module.__file__}); rename the file"
        )
    of_installed = (plugin.top_module for group in GROUPS for plugin in installed(group))
    if not already and len(_registered) == before and text.partition(".")[0] not in of_installed:
        raise UserError(f"plug-in {text} registers nothing; call nbv.plugins.register in it")


def asked(needed: Collection[Plugin] | None = None) -> list[str]:
    """What `use` must be told in a worker; of planners those ``needed``, where it is to run their mission alone.

    `UserError` where a part was registered in a script or notebook itself, which no worker can import.
    """
    brought = [p for p in _registered.values() if needed is None or p.group not in PLANNERS or p in needed]
    for plugin in brought:
        if not plugin.asked:
            raise UserError(
                f"{GROUPS[plugin.group][0]} {plugin.name!r} was registered in a script or notebook itself, which workers "
                "cannot import; write it to a module of its own and import that"
            )
    return list(dict.fromkeys(plugin.asked for plugin in brought))


def used() -> dict[str, dict[str, str]]:
    """Distribution, version and source digest of what this process has loaded, by ``group/name``."""
    return {f"{group}/{name}": plugin.facts for (group, name), plugin in sorted(_used.items())}


def plugins(group: str) -> dict[str, Plugin]:
    """The parts of a group by name, those registered in this process first; what two share cannot be `Plugin.loaded`."""
    found = {name: plugin for (of, name), plugin in _registered.items() if of == group}
    for plugin in installed(group):
        earlier = found.setdefault(plugin.name, plugin)
        if earlier.reference != plugin.reference:
            found[plugin.name] = dataclasses.replace(earlier, rival=plugin.label)
    return found


def beside(own: Collection[str], group: str) -> dict[str, Plugin]:
    """The plug-ins of a group that have no built-in part's name (``own``).

    An installed one that has is left out, which `left_out` tells; `UserError` where it was registered.
    """
    found = plugins(group)
    for taken in own & found.keys():
        leave_out(found.pop(taken))
    return found


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


def sources(group: str, *names: str) -> list[str]:
    """Source digests of the plug-ins among ``names``, for the cache keys of what they compute."""
    found = plugins(group)
    return [found[name].source for name in names if name in found and (group, name) not in _left_out]


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


# -- what guards the import of a part -------------------------------------------------------------

_own_process = False  # this process is one mission's alone
_environment: dict[str, str | None] = {}  # variables that the import of a part changed, as they were before


def own_process() -> None:
    """From now on parts are imported unguarded: whatever they do to this process harms one mission alone."""
    global _own_process
    _own_process = True


def environment() -> dict[str, str]:
    """The environment for other processes: without what the import of parts has changed in this one."""
    found = {**os.environ, **_environment}
    return {name: value for name, value in found.items() if value is not None}


def _imported(name: str, label: str) -> Any:
    """The module ``name``; `UserError` where its import raises, or would end, hang or cripple this process."""
    if name in sys.modules:
        return sys.modules[name]
    if harm := "" if _own_process else _harm_of(name):
        raise UserError(f"{label} cannot be imported: {harm}")
    try:
        with contextlib.nullcontext() if _own_process else _as_before():
            return importlib.import_module(name)
    except UserError:  # of what it registers
        raise
    except (Exception, SystemExit) as error:  # whatever another's module raises
        raise UserError(f"{label} cannot be imported: {said(error)}{_place_of(error, name)}") from error


def _harm_of(name: str) -> str:
    """What importing a module does that no ``except`` catches, tried in a child process; empty where that cannot be tried, too."""
    if not sys.platform.startswith("linux") or len([*Path("/proc/self/task").iterdir()]) > 1:
        return ""  # a process with threads cannot be forked
    reads, writes = os.pipe()
    child = os.fork()
    if not child:
        _try_import(name, writes)
    os.close(writes)
    try:
        in_time = bool(select.select([reads], [], [], IMPORT_S)[0])
        told = os.read(reads, 4 * SAID_LETTERS).decode(errors="replace") if in_time else ""
    finally:
        os.close(reads)
        with contextlib.suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
        with contextlib.suppress(ChildProcessError):
            os.waitpid(child, 0)
    if not in_time:
        return f"it takes longer than {IMPORT_S:g} s"
    return told.strip() if told else "it ends the process that imports it, without an error"


def _try_import(name: str, answer: int) -> None:
    """Import in a forked child that ends here; what is wrong, or a blank, goes into the pipe ``answer``."""
    told = " "
    try:
        null = os.open(os.devnull, os.O_RDWR)
        for number in range(3):
            os.dup2(null, number)
        importlib.import_module(name)
        if not all(Path(f"/proc/self/fd/{number}").exists() for number in range(3)):
            told = "it closes files that are not its own"
        elif sys.stdout.closed or sys.stderr.closed:
            told = "it closes sys.stdout or sys.stderr"
    except Exception:
        pass  # so it will here
    except BaseException as error:
        told = said(error) + _place_of(error, name)
    finally:
        with contextlib.suppress(OSError):
            os.write(answer, told.encode())
        os._exit(0)


@contextlib.contextmanager
def _as_before() -> Iterator[None]:
    """Put back what an import changes of this process: the working directory, handlers of signals, standard streams."""
    folder = os.open(".", os.O_RDONLY)
    variables, streams = dict(os.environ), (sys.stdout, sys.stderr)
    handlers = {number: signal.getsignal(number) for number in signal.valid_signals()}
    try:
        yield
    finally:
        os.fchdir(folder)
        os.close(folder)
        sys.stdout, sys.stderr = streams
        for number, handler in handlers.items():
            if handler is not None and signal.getsignal(number) is not handler:
                with contextlib.suppress(ValueError, OSError):  # in a thread, or one that none may handle
                    signal.signal(number, handler)
        for variable in {name for name, _ in variables.items() ^ os.environ.items()}:
            _environment.setdefault(variable, variables.get(variable))


def said(error: BaseException) -> str:
    """``ValueError: what it says``, on one line and not too long, whatever the error's own methods do."""
    try:
        text = " ".join(str(error)[: 10 * SAID_LETTERS].split())
    except Exception:
        text = "(it cannot be printed)"
    return shortened(f"{type(error).__name__}: {text}" if text else type(error).__name__)


def shortened(text: str) -> str:
    """At most `SAID_LETTERS` of it."""
    return text if len(text) <= SAID_LETTERS else f"{text[: SAID_LETTERS - 1]}…"


def _place_of(error: BaseException, module: str) -> str:
    """`` (mine.py, line 12)``: the last line of the module's package that was running; empty where none was."""
    top = module.partition(".")[0]
    return f" ({_lines(error)[top]})" if top in _lines(error) else ""


def _lines(error: BaseException) -> dict[str, str]:
    """The last line that was running of each package, by its name, innermost last."""
    lines: dict[str, str] = {}
    for frame, line in traceback.walk_tb(error.__traceback__):
        package = str(frame.f_globals.get("__name__")).partition(".")[0]
        lines.pop(package, None)
        lines[package] = f"{Path(frame.f_code.co_filename).name}, line {line}"
    return lines


# -- what guards a part's calls -------------------------------------------------------------------


def read_only(value: Any) -> Any:
    """A copy whose arrays nobody can write to, neither from it to ours nor through their ``base``.

    Of an array, or of all arrays in a dataclass, tuple or dictionary; anything else is shared.
    """
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        return np.ndarray(value.shape, value.dtype, value.tobytes())
    if isinstance(value, tuple):
        return tuple(map(read_only, value)) if any(map(_has_arrays, value)) else value
    is_dict = isinstance(value, dict)
    if not is_dict and (not dataclasses.is_dataclass(value) or isinstance(value, type)):
        return value
    other = copy.copy(value)
    if is_dict:
        other |= {name: read_only(own) for name, own in value.items()}
    for name, own in vars(value).items() if hasattr(value, "__dict__") else ():
        object.__setattr__(other, name, read_only(own))
    return other


def _has_arrays(value: Any) -> bool:
    return isinstance(value, (np.ndarray, dict, tuple)) or dataclasses.is_dataclass(value)


def failure_of(error: BaseException) -> MissionFailure | None:
    """How a mission ends in which a plug-in's code raised ``error``; None where none of it was running.

    A `MissionFailure` is a plug-in's only where it raises it itself: one of ours may pass through its code. A fidelity is the
    mission itself: what it raises is told as of a built-in one.
    """
    lines = _lines(error)
    if isinstance(error, MissionFailure) and next(reversed(lines), "") == "nbv":
        return None
    lines.pop("nbv", None)
    plugin = next((p for p in _used.values() if p.top_module in lines and p.group != "fidelities"), None)
    if plugin is None:
        return None
    hint = "; a plug-in must not change what it is given" if "read-only" in said(error) else ""
    where = lines[plugin.top_module]
    return MissionFailure("plugin_failed", f"plug-in {plugin.origin} raised {said(error)} ({where}){hint}")


def _require_numbers(plugin: Plugin, values: Any, count: int) -> Any:
    """``values`` as (count,) finite numbers; else the mission fails."""
    try:
        array = np.array(values, dtype=float)
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


@contextlib.contextmanager
def _blamed(plugin: Plugin) -> Iterator[None]:
    """What is raised here, in code of ours, for what ``plugin`` returned is its failure."""
    try:
        yield
    except MissionFailure:
        raise
    except Exception as error:
        if failure_of(error) is not None:
            raise
        told = shortened(f"{plugin.label} returned what cannot be used: {said(error)}")
        raise MissionFailure("plugin_failed", told) from error


def _guarded_scorer(plugin: Plugin, scorer: Any) -> Any:
    def main_term(terms: Any, pool: Any, config: Any) -> Any:
        return _require_numbers(plugin, scorer.main_term(terms, pool, config), len(pool))

    def rank(terms: Any, pool: Any, config: Any) -> Ranking:
        with _blamed(plugin):
            return _ranking(
                plugin, checked.rank(read_only(terms), read_only(pool), copy.deepcopy(config)), len(pool)
            )

    checked = dataclasses.replace(scorer, name=plugin.name, main_term=main_term)
    guarded = copy.copy(checked)
    object.__setattr__(guarded, "rank", rank)  # in place of the method, which may be the plug-in's own
    return guarded


def _guarded_gate(plugin: Plugin, gate: Any) -> Any:
    def decide(self: Any, state: Any, pool: Any, rankings: Any) -> Any:
        with _blamed(plugin):
            decision = gate.decide(self, read_only(state), read_only(pool), read_only(rankings))
            if not isinstance(decision, GateDecision):
                told = f"{plugin.label} returned {type(decision).__name__}, no nbv.types.GateDecision"
                raise MissionFailure("plugin_failed", shortened(told))
            ranking = _ranking(plugin, decision.ranking, len(pool))
            details = msgspec.json.encode(decision.details, enc_hook=_plain)
            if len(details) > DETAILS_BYTES:
                told = f"{plugin.label} returned details of {len(details)} bytes; at most {DETAILS_BYTES} are kept"
                raise MissionFailure("plugin_failed", told)
            return GateDecision(ranking, shortened(str(decision.reason)), msgspec.json.decode(details))

    def retargeted(self: Any, config: Any) -> Any:
        other = gate.retargeted(self, copy.deepcopy(config))
        if not isinstance(other, guarded):
            told = f"{plugin.label} became {type(other).__name__} for another target"
            raise MissionFailure("plugin_failed", shortened(told))
        return other

    own = {"decide": decide, "retargeted": retargeted, "__module__": gate.__module__}
    guarded = type(gate.__name__, (gate,), own)
    return guarded


def _ranking(plugin: Plugin, ranking: Any, count: int) -> Ranking:
    """What ``ranking`` says, checked, in an object and arrays of our own."""
    scores = _require_numbers(plugin, ranking.scores, count)
    order = np.array(ranking.order, dtype=np.int64)
    if not np.array_equal(np.sort(order), np.arange(count)):
        raise MissionFailure("plugin_failed", f"{plugin.label} returned an order that is no permutation")
    terms = {shortened(str(name)): np.array(values, dtype=float) for name, values in ranking.terms.items()}
    if len(terms) > MOST_TERMS or any(values.shape != (count,) for values in terms.values()):
        raise MissionFailure(
            "plugin_failed",
            f"{plugin.label} returned more than {MOST_TERMS} terms, or some not of the shape ({count},)",
        )
    return Ranking(shortened(str(ranking.scorer)), order, scores, terms)


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else shortened(str(value))
