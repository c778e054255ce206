"""The table of all reports: on a page by the macro of ``macros.html.j2``, on the terminal and in Markdown by its methods."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import rich.table
from rich.text import Text

from tuner.report.terminal import whole_tables


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

    def for_terminal(self, width: int) -> Iterator[rich.table.Table]:
        """The table, or several below one another where not all columns fit into ``width`` characters."""
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
        return whole_tables(self.columns, rows, width, self.title, self.caption)

    def markdown(self) -> str:
        """The table in Markdown, best values in bold."""
        lines = ["| " + " | ".join(self.columns) + " |", "|---|" + "---:|" * (len(self.columns) - 1)]
        for row in self.rows:
            texts = [
                "<br>".join((f"**{cell.text}**" if cell.best else cell.text, *cell.below))
                for cell in row.cells
            ]
            texts += [""] * (len(self.columns) - 1 - len(texts))
            lines.append("| " + " | ".join((row.name, *texts)) + " |")
        return "\n".join(lines)
