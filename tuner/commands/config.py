"""``gatetune config show``."""

from __future__ import annotations

from collections.abc import Iterator
from operator import attrgetter
from typing import Annotated, Any

import typer
import yaml
from rich.table import Table

from nbv.config import PRESETS, MissionConfig, Parameter, parameters
from tuner.commands.console import PRESET_NAMES, AsJson, answer_json, mission_config, output

app = typer.Typer(no_args_is_help=True)


@app.command()
def show(
    preset: Annotated[str, typer.Option(help=PRESET_NAMES)] = "paper",
    set_: Annotated[list[str] | None, typer.Option("--set", help="PATH=VALUE")] = None,
    as_json: AsJson = False,
) -> None:
    """The complete configuration of a preset as YAML, with every value's unit, meaning and source as a comment.

    Every key is a parameter path. Sources: text (the paper), code (the authors' public code), ours.

    Example: gatetune config show --preset campaign
    """
    config = mission_config(preset, set_ or [])
    for line in (f"# {PRESETS[preset].purpose}", *commented_yaml(config)):
        output.print(line, highlight=False, soft_wrap=True)
    rows = [
        {
            "path": about.path,
            "value": attrgetter(about.path)(config),
            "unit": about.unit,
            "meaning": about.meaning,
            "choices": about.choices,
            "source": _origin(about, attrgetter(about.path)(config), preset),
        }
        for about in parameters().values()
    ]
    answer_json({"preset": preset, "purpose": PRESETS[preset].purpose, "parameters": rows})


def metrics(as_json: AsJson = False) -> None:
    """Every metric that `--metric` takes. Put `observable.` or `whole.` before the name: the surface it is of.

    Example: gatetune metrics, then gatetune campaign run --metric observable.completeness_48mm
    """
    from nbv.evaluation.registry import METRICS
    from tuner.problem.objective import COSTS, SHORT

    table = Table(title="--metric SURFACE.NAME, SURFACE observable or whole")
    for column in ("name", "what it is", "unit", "better"):
        table.add_column(column, no_wrap=column == "name")
    found = [
        {
            "name": metric.key.replace("{t}", "T"),
            "what": metric.label.replace("{t}", "T"),
            "unit": metric.unit,
            "better": "larger" if metric.larger_is_better else "smaller",
        }
        for metric in METRICS.values()
    ]
    for row in found:
        table.add_row(*row.values())
    thresholds_mm = MissionConfig().evaluation.thresholds_mm
    costs = {name: path for name, path in SHORT.items() if path in COSTS}
    output.print(table)
    output.print(
        f"T: a threshold in mm, one of {', '.join(f'{t:g}' for t in thresholds_mm)} (evaluation.thresholds_mm)"
    )
    output.print(
        f"costs, as in --objective 'f_score@photographs<=21': {', '.join(costs)}; or {', '.join(COSTS)}"
    )
    answer_json({"metrics": found, "thresholds_mm": thresholds_mm, "costs": COSTS, "short_names": costs})


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
    origin = _origin(about, value, preset)
    return f"{f'{about.unit}; ' if about.unit else ''}{about.meaning} ({origin})"


def _origin(about: Parameter, value: Any, preset: str) -> str:
    default = list(about.default) if isinstance(about.default, tuple) else about.default
    if about.path == "preset" or value == default:
        return about.origin
    if value == PRESETS[preset].values.get(about.path):
        return f"{PRESETS[preset].source}, preset {preset}"
    return "--set"
