"""How a study's page begins: what was flown, and what of it failed."""

from __future__ import annotations

from tuner.missions.registry import GEOMETRIC_NOTE, is_geometric
from tuner.report.style import short_names
from tuner.studies.departures import DepartureFindings
from tuner.studies.oracles import OracleFindings


def preamble(findings: DepartureFindings | OracleFindings) -> list[str]:
    """Markdown lines: preset, overrides, rocks, replicates, surface, missions; fidelity; failures."""
    s = findings.settings
    changed = "".join(f", `{path}={value}`" for path, value in s.overrides.items())
    lines = [
        f"Preset `{s.preset}`{changed}; rocks {', '.join(short_names(s.rocks))}; {s.replicates} replicates. "
        f"{s.surface.capitalize()} surface. {findings.missions} of {findings.expected} missions are in "
        f"({findings.wall_s / 60:.0f} min of missions).",
        "",
    ]
    if is_geometric(s.runner):
        lines += [GEOMETRIC_NOTE, ""]
    if findings.failures:
        counts = ", ".join(f"{reason} {n}" for reason, n in sorted(findings.failures.items()))
        lines += [f"Failed missions by reason: {counts}.", ""]
    return lines
