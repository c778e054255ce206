"""The table of all reports: on a page by the macro of ``macros.html.j2``, on the terminal by its method."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import rich.table
from rich.console import RenderableType
from rich.text import Text


class Cell(NamedTuple):
    """One value, ready to print."""

    text: str  # "71.2 ± 3.1"
    best: bool = False
    below: tuple[str, ...] = ()  # small lines under it, such as a difference


class Row(NamedTuple):
    """One line of a table; without cells it is the heading of those that follow."""

    name: str
    cells: tuple[Cell, ...] = ()
    note: str = ""  # small, below the name, on wide pages alone
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
