"""How a study's page begins: what was flown, and what of it failed."""

from __future__ import annotations

from typing import Any, Protocol

from tuner.missions.registry import GEOMETRIC_NOTE, is_geometric
from tuner.report.style import short_names


class Settings(Protocol):
    """What a study flew."""

    @property
    def rocks(self) -> tuple[str, ...]: ...
    @property
    def replicates(self) -> int: ...
    @property
    def preset(self) -> str: ...
    @property
    def overrides(self) -> dict[str, Any]: ...
    @property
    def surface(self) -> str: ...
    @property
    def fidelity(self) -> str: ...


class Findings(Protocol):
    """What came of it."""

    @property
    def settings(self) -> Settings: ...
    @property
    def missions(self) -> int: ...
    @property
    def expected(self) -> int: ...
    @property
    def failures(self) -> dict[str, int]: ...
    @property
    def wall_s(self) -> float: ...


def preamble(findings: Findings) -> list[str]:
    """Markdown lines: preset, overrides, rocks, replicates, surface, missions; fidelity; failures."""
    s = findings.settings
    changed = "".join(f", `{path}={value}`" for path, value in s.overrides.items())
    lines = [
        f"Preset `{s.preset}`{changed}; rocks {', '.join(short_names(s.rocks))}; {s.replicates} replicates. "
        f"{s.surface.capitalize()} surface. {findings.missions} of {findings.expected} missions are in "
        f"({findings.wall_s / 60:.0f} min of missions).",
        "",
    ]
    if is_geometric(s.fidelity):
        lines += [GEOMETRIC_NOTE, ""]
    if findings.failures:
        counts = ", ".join(f"{reason} {n}" for reason, n in sorted(findings.failures.items()))
        lines += [f"Failed missions by reason: {counts}.", ""]
    return lines
