"""The table of all reports: on a page by the macro of ``macros.html.j2``, on the terminal by its method."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

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

    def for_terminal(self, width: int) -> Iterator[RenderableType]:
        """The table, or several below one another where not all columns fit into ``width`` characters; then the caption."""
        rows: list[list[Text]] = []
        for row in self.rows:
            style = "bold" if row.best else "" if row.cells else "italic"
            texts = [Text(row.name, style=style)]
            for cell in row.cells:
                text = Text(
                    f"{cell.text} *" if cell.best else cell.text, style="bold" if cell.best else style
                )
                texts.append(Text.assemble(text, *((f"\n{line}", "dim") for line in cell.below)))
            rows.append(texts)
        yield from _whole(self.columns, rows, width, self.title)
        if self.caption:
            yield Text(self.caption, style="dim italic")


def _whole(
    columns: Sequence[str], rows: Sequence[Sequence[Text]], width: int, title: str
) -> Iterator[rich.table.Table]:
    """Yield as few tables as fit: no cell is cut off, and the first column, of names, is in all of them.

    A row without cells begins a section; headers may wrap between words.
    """
    widths = [
        max(
            [*map(len, name.split())]
            + [len(line) for row in rows if k < len(row) for line in row[k].plain.splitlines()]
        )
        for k, name in enumerate(columns)
    ]
    between = 2 if sum(widths) + 2 * (len(widths) - 1) <= width else 1  # blanks between columns
    widths[0] = min(widths[0], max(1, width - between - max(widths[1:], default=0)))
    groups: list[list[int]] = [[]]
    for k in range(1, len(columns)):
        together = [0, *groups[-1], k]
        if groups[-1] and sum(widths[i] + between for i in together) - between > width:
            groups.append([])
        groups[-1].append(k)
    for number, group in enumerate(groups):
        table = rich.table.Table(
            title=title if number == 0 else None, box=None, padding=(0, between, 0, 0), pad_edge=False
        )
        table.title_justify = "left"
        room = width + between - sum(widths[k] + between for k in (0, *group))
        for k in (0, *group):  # headers in one line as far as there is room
            more = max(0, min(room, len(columns[k]) - widths[k]))
            room -= more
            side: Literal["left", "right"] = "right" if k else "left"
            table.add_column(columns[k], justify=side, width=widths[k] + more, overflow="fold")
        for row in rows:
            table.add_row(*(row[k] for k in (0, *group) if k < len(row)))
        yield table
