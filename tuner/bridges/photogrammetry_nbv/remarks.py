"""What a conversion has to say: a value that cannot be expressed, a unit that does not carry over."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Remark:
    """One thing that does not carry over."""

    key: str  # the parameter path or the key that it is about
    text: str  # what is lost, in one line
    partly: bool = False  # the value is written, though not all that it means here

    def __str__(self) -> str:
        return f"{self.key}: {self.text}"
