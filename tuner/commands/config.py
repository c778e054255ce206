"""``gatetune config show``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

import typer
import yaml
from rich.table import Table

from nbv.config import PRESETS, MissionConfig, Parameter, parameters
from tuner.commands.console import PRESET_NAMES, mission_config, output

app = typer.Typer(no_args_is_help=True)


@app.command()
def show(
    preset: Annotated[str, typer.Option(help=PRESET_NAMES)] = "paper",
    set_: Annotated[list[str] | None, typer.Option("--set", help="PATH=VALUE")] = None,
) -> None:
    """The complete configuration of a preset as YAML, with every value's unit, meaning and source as a comment.

    Every key is a parameter path. Sources: text (the paper), code (the authors' public code), ours.

    Example: gatetune config show --preset campaign
    """
    config = mission_config(preset, set_ or [])
    typer.echo(f"# {PRESETS[preset].purpose}")
    for line in commented_yaml(config):
        typer.echo(line)


def metrics() -> None:
    """Every metric that `--metric` takes. Put `observable.` or `whole.` before the name: the surface it is of.

    Example: gatetune metrics, then gatetune campaign run --metric observable.completeness_48mm
    """
    from nbv.evaluation.registry import METRICS
    from tuner.problem.quality_at_cost import COSTS, SHORT

    table = Table(title="--metric SURFACE.NAME, SURFACE observable or whole")
    for column in ("name", "what it is", "unit", "better"):
        table.add_column(column, no_wrap=column == "name")
    for metric in METRICS.values():
        better = "larger" if metric.larger_is_better else "smaller"
        table.add_row(metric.key.replace("{t}", "T"), metric.label.replace("{t}", "T"), metric.unit, better)
    thresholds = ", ".join(f"{t:g}" for t in MissionConfig().evaluation.thresholds_mm)
    output.print(table)
    output.print(f"T: a threshold in mm, one of {thresholds} (evaluation.thresholds_mm)")
    output.print(
        f"costs, as in --objective 'f_score@photographs<=21': {', '.join(name for name, path in SHORT.items() if path in COSTS)}; "
        f"or {', '.join(COSTS)}"
    )


def commented_yaml(config: MissionConfig) -> list[str]:
    """The configuration as lines of YAML, a comment beside every value."""
    rows = list(_rows(config.to_dict(), "", config.preset))
    width = max(len(line) for line, comment in rows if comment)
    return [f"{line:<{width}}  # {comment}" if comment else line for line, comment in rows]


def _rows(tree: dict[str, Any], prefix: str, preset: str) -> Iterator[tuple[str, str]]:
    indent = "  " * prefix.count(".")
    for name, value in tree.items():
        if isinstance(value, dict):
            yield f"{indent}{name}:", ""
            yield from _rows(value, f"{prefix}{name}.", preset)
        else:
            about = parameters()[f"{prefix}{name}"]
            flow = None if isinstance(value, list) else False  # a list in its line
            text = yaml.safe_dump({name: value}, default_flow_style=flow).strip()
            yield f"{indent}{text}", _comment(about, value, preset)


def _comment(about: Parameter, value: Any, preset: str) -> str:
    default = list(about.default) if isinstance(about.default, tuple) else about.default
    if about.path == "preset" or value == default:
        origin = about.origin
    elif value == PRESETS[preset].values.get(about.path):
        origin = f"{PRESETS[preset].source}, preset {preset}"
    else:
        origin = "--set"
    return f"{f'{about.unit}; ' if about.unit else ''}{about.meaning} ({origin})"
