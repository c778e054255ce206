"""Tables for a terminal of any width, whole: no cell is cut off, and what is best can be told without colours."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal

from rich.table import Table
from rich.text import Text


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
    between = 2 if sum(widths) + 2 * (len(widths) - 1) <= width else 1  # blanks between columns
    widths[0] = min(widths[0], max(1, width - between - max(widths[1:], default=0)))
    groups: list[list[int]] = [[]]
    for k in range(1, len(columns)):
        together = [0, *groups[-1], k]
        if groups[-1] and sum(widths[i] + between for i in together) - between > width:
            groups.append([])
        groups[-1].append(k)
    for number, group in enumerate(groups):
        table = Table(
            title=title if number == 0 else None, box=None, padding=(0, between, 0, 0), pad_edge=False
        )
        table.title_justify = table.caption_justify = "left"
        room = width + between - sum(widths[k] + between for k in (0, *group))
        for k in (0, *group):  # headers in one line as far as there is room
            more = max(0, min(room, len(columns[k]) - widths[k]))
            room -= more
            side: Literal["left", "right"] = "right" if k else "left"
            table.add_column(columns[k], justify=side, width=widths[k] + more, overflow="fold")
        for row in texts:
            table.add_row(*(row[k] for k in (0, *group) if k < len(row)))
        table.caption = caption if number == len(groups) - 1 else None
        yield table
