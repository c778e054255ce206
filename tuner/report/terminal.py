"""Tables for a terminal of any width, whole: no cell is cut off, and what is best can be told without colours."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rich.table import Table
from rich.text import Text

_BETWEEN = 3  # a border and a blank on either side


def whole_tables(
    columns: Sequence[str], rows: Sequence[Sequence[Text | str]], width: int, title: str, caption: str = ""
) -> Iterator[Table]:
    """Yield a table, or several below one another where not all columns fit into ``width`` characters.

    The first column, of names, is in all of them. A row without cells begins a section; headers may wrap between words.
    """
    texts = [[cell if isinstance(cell, Text) else Text(cell) for cell in row] for row in rows]
    widths = [
        max(
            [*map(len, name.split())]
            + [len(line) for row in texts if k < len(row) for line in row[k].plain.splitlines()]
        )
        for k, name in enumerate(columns)
    ]
    groups: list[list[int]] = [[]]
    for k in range(1, len(columns)):
        together = [0, *groups[-1], k]
        if groups[-1] and 1 + sum(widths[i] + _BETWEEN for i in together) > width:
            groups.append([])
        groups[-1].append(k)
    for number, group in enumerate(groups):
        table = Table(title=title if number == 0 else None, width=None)
        for k in (0, *group):
            table.add_column(
                columns[k], justify="right" if k else "left", min_width=widths[k], overflow="fold"
            )
        for row in texts:
            if len(row) < 2:
                table.add_section()
            table.add_row(*(row[k] for k in (0, *group) if k < len(row)))
        table.caption = caption if number == len(groups) - 1 else None
        yield table
