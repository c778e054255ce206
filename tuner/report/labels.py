"""Names and units for people: of metrics, of tuned parameters, of strategies."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import rich.table
from rich.console import RenderableType
from rich.text import Text

from nbv.config import parameter
from nbv.errors import UserError
from nbv.evaluation.registry import find_metric
from tuner.missions.registry import kind_on, mission_kind

if TYPE_CHECKING:
    from tuner.problem.intervals import Interval


# The table of all reports: on a page by the macro of ``macros.html.j2``, on the terminal by its method.


class Cell(NamedTuple):
    """One value, ready to print."""

    text: str  # "71.2 ± 3.1"
    best: bool = False
    below: tuple[str, ...] = ()  # small lines under it, such as a difference


class Row(NamedTuple):
    """One line of a table; without cells it is the heading of those that follow."""

    name: str
    cells: tuple[Cell, ...] = ()
    best: bool = False


@dataclass(frozen=True)
class Table:
    """Rows of text; the first column is of the rows' names."""

    title: str
    columns: tuple[str, ...]
    rows: list[Row]
    caption: str = ""

    @staticmethod
    def of(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], caption: str = "") -> Table:
        """A table of plain texts, the name of each row first."""
        return Table(
            title, tuple(columns), [Row(name, tuple(map(Cell, texts))) for name, *texts in rows], caption
        )

    def for_terminal(self) -> Iterator[RenderableType]:
        """The table, then its caption."""
        table = rich.table.Table(title=self.title, box=None, padding=(0, 1, 0, 0), pad_edge=False)
        table.title_justify = "left"
        for k, name in enumerate(self.columns):
            table.add_column(name, justify="right" if k else "left", overflow="fold", no_wrap=not k)
        for row in self.rows:
            style = "bold" if row.best else "" if row.cells else "italic"
            cells = [
                Text.assemble(
                    (f"{cell.text} *" if cell.best else cell.text, "bold" if cell.best else style),
                    *((f"\n{line}", "dim") for line in cell.below),
                )
                for cell in row.cells
            ]
            table.add_row(Text(row.name, style=style), *cells)
        yield table
        if self.caption:
            yield Text(self.caption, style="dim italic")


MISSING = "–"
# With more decimals what is smaller is written with an exponent; so is what has an uncertainty of more digits than `LARGE`.
MOST_DECIMALS, LEAST_DECIMAL, LARGE = 6, 1e-3, 4
HELD_DIGITS = 13  # that a number in double precision surely has
SURFACES = {"whole": "whole surface", "observable": "observable surface"}
COSTS = {
    "images": ("Photographs", ""),
    "registered_images": ("Registered photographs", ""),
    "flight_time_s": ("Flight", "s"),
    "path_length_m": ("Path", "m"),
    "energy_wh": ("Energy", "Wh"),
    "wall_s": ("Computing", "s"),
}


@dataclass(frozen=True)
class Label:
    """How a metric or a parameter is written. ``unit`` is of the value, ``difference_unit`` of a difference of two values."""

    name: str  # "F-score @ 48 mm", "Gate: budget fraction"
    unit: str  # "%", "mm", "" ...
    surface: str = ""  # "observable surface", ...; empty if the metric has none

    @property
    def full(self) -> str:
        return f"{self.name}, {self.surface}" if self.surface else self.name

    @property
    def axis(self) -> str:
        return f"{self.name} ({self.unit})" if self.unit else self.name

    @property
    def difference_unit(self) -> str:
        """Differences of percentages are percentage points."""
        return "points" if self.unit == "%" else self.unit


def with_unit(number: float | None, unit: str, digits: int = 1) -> str:
    """``12.34, "mm"`` as ``12.3 mm``; a dash for a missing value."""
    text = format_number(number, digits)
    return text if not unit or text == MISSING else f"{text} {unit}"


def format_number(number: float | None, digits: int = 1, *, signed: bool = False) -> str:
    """Decimals, of what is tiny or huge as ``2.5e-9``, with a true minus sign; a dash for a missing value."""
    if number is None or not math.isfinite(number):
        return MISSING
    sign, size = "+" if signed else "", abs(number)
    if size > 1e-300 and digits + math.floor(math.log10(size)) > HELD_DIGITS:
        digits = 2  # a spread below the rounding of the number says nothing of its digits
    if digits < 0 or (digits > MOST_DECIMALS and size < LEAST_DECIMAL):
        rounded = round(number, digits)
        places = max(0, digits + math.floor(math.log10(abs(rounded)))) if rounded else 0
        text = (
            re.sub(r"e([+-])0*", r"e\1", f"{rounded:{sign}.{places}e}").replace("e+", "e") if rounded else "0"
        )
    else:
        text = f"{number:{sign}.{digits}f}"
        if float(text) == 0:  # no "-0.0"
            text = f"{0:.{digits}f}"
    return text.replace("-", "−")


def number_text(number: float) -> str:
    """A number without a known uncertainty: two decimals, or its first digits where two decimals would show nothing."""
    plain = number == 0 or 0.1 <= abs(number) < 1e10
    return format_number(number, 2 if plain else 3 - math.floor(math.log10(abs(number))))


def bracketed(
    mean: float | None, low: float | None, high: float | None, digits: int = 1, *, signed: bool = False
) -> str:
    """``+0.2 [−0.4, +0.8]``, a mean and the bounds of its 95 % interval; the mean alone without bounds."""
    text, *bounds = (format_number(value, digits, signed=signed) for value in (mean, low, high))
    return text if low is None or low == high else f"{text} [{', '.join(bounds)}]"


def difference_text(d: Interval | None, digits: int = 1, *, signed: bool = True) -> str:
    """The same of an interval; a dash for None."""
    return MISSING if d is None else bracketed(d.mean, d.low, d.high, digits, signed=signed)


def gain_words(gain: float, unit: str) -> str:
    """``a gain of 3.2 points``, ``a loss of 3.2 points``; ``no difference`` where it is rounded to nothing."""
    size = with_unit(abs(gain), unit)
    return "no difference" if round(gain, 1) == 0 else f"a {'gain' if gain > 0 else 'loss'} of {size}"


def ceiling_text(ceiling: Interval, plain: str, *, room: bool) -> str:
    """What the greedy oracle has above the best plain plan, and whether that leaves room for a planner."""
    most = ceiling.mean if ceiling.high is None else ceiling.high
    if room:
        what = f"up to {most:.1f} points can be gained here, so try planners."
    elif most <= 0.0:
        what = "even that gains nothing here."
    else:
        what = f"no planner can be expected to gain more than {most:.1f} points here."
    has = f"has {difference_text(ceiling)} points over {plain}"
    return f"The greedy oracle, which sees the true surface, {has}: {what}"


def duration(seconds: float) -> str:
    """``75.2`` as ``75 s``, 179.8 as ``3 min 0 s``, 5400 as ``1 h 30 min``."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    seconds = round(seconds)
    if seconds < 5400:
        return f"{seconds // 60} min {seconds % 60} s"
    return f"{seconds // 3600} h {seconds % 3600 // 60} min"


def counted(count: int, what: str) -> str:
    """``1 rock``, ``3 rocks``."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def decimals_for(spread: float, significant: int = 2) -> int:
    """Decimals that show this many digits of an uncertainty, at least 1; negative, as for `round`, for a huge one."""
    if not math.isfinite(spread) or spread <= 0:
        return 1
    decimals = significant - 1 - math.floor(math.log10(spread))
    return decimals if decimals < -LARGE else max(1, decimals)


def metric_label(path: str) -> Label:
    """Label of a metric path of ``MissionResult.metrics`` such as ``observable.f_score_48mm``.

    Unknown paths are shown as they are, with the unit that their ending tells.
    """
    *prefix, key = path.split(".")
    if prefix == ["costs"]:
        prefix = []  # no surface
        if key in COSTS:
            name, unit = COSTS[key]
            return Label(name, unit)
    surface = ", ".join(SURFACES.get(part) or part for part in reversed(prefix))
    floor = "_floor_mm" if key.endswith("_floor_mm") else ""
    if known := find_metric(f"{key.removesuffix(floor)}_mm" if floor else key):
        metric, name = known
        name = f"{name}, the rock's own floor" if floor else name
        return Label(name, metric.unit, surface)
    for ending, unit in (("_mm", "mm"), ("_m", "m"), ("_s", "s"), ("_deg", "°"), ("_px", "px")):
        if key.endswith(ending):
            return Label(_words(key.removesuffix(ending)), unit, surface)
    return Label(_words(key), "", surface)


def measure_text(metric: str, fidelity: str, rocks: Sequence[str], conditions: Sequence[str]) -> str:
    """What every number of a page is: the metric's name, then fidelity and conditions."""
    kinds = {kind_on(rock, fidelity) for rock in rocks}
    kind = kinds.pop() if len(kinds) == 1 else mission_kind(fidelity)
    text = f"{metric}; {kind.numbers_are or f'{fidelity} missions'}"
    if kind.targets == "photographs":
        return text
    return f"{text}; condition{'s' if len(conditions) > 1 else ''} {', '.join(conditions)}"


def parameter_label(path: str) -> Label:
    """Label of a parameter path of ``MissionConfig``; other names as they are."""
    try:
        about = parameter(path)
    except UserError:
        return Label(path, "")
    section, name = about.section.replace("_", "-").capitalize(), about.label or about.words
    return Label(f"{section}: {name}" if section else name, about.unit)


def _words(key: str) -> str:
    text = key.replace("_", " ").strip()
    return text[:1].upper() + text[1:]


def short_names(names: Sequence[str]) -> list[str]:
    """Rocks may be mesh files: show the stem; names that would then collide stay whole."""
    stems = [
        Path(name).stem if "/" in name or name.endswith((".ply", ".obj", ".stl", ".glb")) else name
        for name in names
    ]
    return [stem if stems.count(stem) == 1 else name for stem, name in zip(stems, names)]
