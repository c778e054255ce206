"""What the sections of a mission's configuration share: each checks its own values."""

from __future__ import annotations

from dataclasses import fields

from nbv.errors import UserError


class Section:
    """What the sections share: checks that name the field, its value and the rule."""

    def _need(self, ok: bool, name: str, rule: str) -> None:
        if not ok:
            raise UserError(f"{name} is {getattr(self, name)!r}; it must be {rule}")

    def _need_positive(self, *names: str) -> None:
        for name in names:
            self._need(getattr(self, name) > 0, name, "positive")

    def _need_at_least(self, low: float, *names: str) -> None:
        rule = "0 or more" if low == 0 else f"at least {low:g}"
        for name in names:
            self._need(getattr(self, name) >= low, name, rule)

    def __post_init__(self) -> None:
        """Check what fields declare: a range, or that a name is one of a part of the program."""
        for f in fields(self):  # type: ignore[arg-type]
            value, least, most = getattr(self, f.name), f.metadata.get("least"), f.metadata.get("most")
            if least is not None and most is not None:
                self._need(least <= value <= most, f.name, f"between {least:g} and {most:g}")
            elif least is not None:
                self._need_at_least(least, f.name)
            if "names" in f.metadata and value not in (allowed := f.metadata["names"]()):
                raise UserError(f"{f.name} is {value!r}; allowed: {', '.join(allowed)}")

    def _need_elevations(self, *names: str) -> None:
        for name in names:
            inside = all(-90.0 < elevation < 90.0 for elevation in getattr(self, name))
            self._need(inside, name, "elevations between -90 and 90 degrees")
