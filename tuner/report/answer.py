"""The answer of a campaign in a surveyor's words: what page and terminal both say."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from nbv.config import MissionConfig
from tuner.missions.registry import is_geometric
from tuner.problem.objective import reached
from tuner.problem.observations import short
from tuner.problem.search_space import Configuration
from tuner.report.labels import (
    MetricLabel,
    decimals_for,
    format_number,
    metric_label,
    parameter_label,
    with_unit,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from typing import Any

    from tuner.campaign.settings import CampaignSettings
    from tuner.recommendation.recommendation import Limit, Recommendation

FEW = 3  # changes that a sentence can name
PLAN = ("seed.", "stop.", "pool.max_altitude_m")  # parameters that `plan_words` puts into words
LEANS = "The intervals are of the best of those flown, where it was tuned: they lean towards optimism."
GEOMETRIC = "Predicted by geometric missions: no photograph was taken."


# -- what to use ---------------------------------------------------------------------------------------------


def use_sentence(best: Recommendation, s: CampaignSettings) -> str:
    """``Use 14 photographs on rings, then 12 chosen by the planner, none above 1.45 m.``"""
    if best.limit is not None and not best.limit.kept:
        likeliest = "the default" if best.keep_default else configuration_words(best.values, best, s)
        return f"Nothing flown is likely to keep {limit_words(best.limit)}; the likeliest is {likeliest}."
    if best.keep_default:
        plan = plan_words(s.config(best.values), ceiling=False)
        return f"Keep the default{f' ({plan})' if plan else ''}: nothing flown is known to be better."
    return f"Use {configuration_words(best.values, best, s)}."


def configuration_words(values: Mapping[str, Any], best: Recommendation, s: CampaignSettings) -> str:
    """A configuration by what it changes of the default."""
    changed = [path for path, value in values.items() if value != best.default_values[path]]
    planned = [path for path in changed if path.startswith(PLAN)]
    plan = plan_words(s.config(values), ceiling="pool.max_altitude_m" in changed) if planned else ""
    rest = [path for path in changed if not plan or path not in planned]
    if len(rest) > FEW:
        named = f"{len(rest)} changes"
    else:
        named = ", ".join(f"{parameter_label(path).name} {value_text(values, path)}" for path in rest)
    if plan:
        return f"{plan}; and {named}" if rest else plan
    return f"the default with {named}" if rest else "the default"


def plan_words(config: Configuration, *, ceiling: bool) -> str:
    """How many photographs are taken where; empty for a mission that is not ours."""
    if not isinstance(config, MissionConfig):
        return ""
    seed, stop = config.seed, config.stop
    rings = f"{seed.total} photographs on rings"
    if seed.count and seed.rings == 1:
        rings = f"{seed.count - seed.upper_count} photographs at {seed.lowest_deg:.0f}°"
        rings += f" and {seed.upper_count} at {seed.upper_deg:.0f}°" if seed.upper_count else ""
    if not config.adaptive_budget:
        return rings
    words = f"{rings}, then {config.adaptive_budget} chosen by the planner"
    if stop.may_end_early:
        words = f"{rings}; go on where the model is weak, up to {seed.total + config.adaptive_budget}"
    return f"{words}, none above {config.pool.max_altitude_m:.3g} m" if ceiling else words


def value_text(values: Mapping[str, Any], path: str) -> str:
    """A tuned value with its unit."""
    return f"{short(values[path])} {parameter_label(path).unit}".strip()


# -- what it is worth ----------------------------------------------------------------------------------------


def worth_sentences(best: Recommendation, s: CampaignSettings) -> list[str]:
    """What the recommendation is worth on the training rocks, then on the next one."""
    said = _exact_worth(best, s) if best.exact else _modelled_worth(best, s)
    if best.next_rock is not None:
        said += best.next_rock.warnings(place_word(s))
    if is_geometric(s.fidelity):
        said.append(GEOMETRIC)
    return said


def _exact_worth(best: Recommendation, s: CampaignSettings) -> list[str]:
    cost, limit = metric_label(best.metric), best.limit
    name = cost.name[:1].lower() + cost.name[1:]
    said = exact_text(best.mean, cost, name)
    if not best.keep_default:
        said += f" in place of {exact_text(best.default_mean, cost)}"
        if limit is not None and best.improvement < 0:  # why anybody should pay more
            said += f", because the default keeps {_bound_words(limit)} with probability {limit.default_probability:.2f}"
    if limit is None:
        return [f"{said}; what that does to {_short(metric_label(best.modelled_metric))} is below."]
    share, label = reached(limit.metric), metric_label(limit.metric)
    digits = 0 if share else _decimals(limit.sd)
    interval = _interval(map(label.possible, limit.interval_95), digits)
    quality = (
        f"{_short(label)} {label.value(limit.mean, digits)} on the training {place_word(s)}s ({interval}"
    )
    if share:
        quality = (
            f"{_reach_words(share)} on {label.value(limit.mean, digits)} of {place_word(s)}s ({interval}"
        )
    if limit.flown is not None:
        quality += "; on {} of the {} that were flown".format(*limit.flown)
    if not best.keep_default:
        quality += f"; {label.value(limit.default_mean, digits)} with the default"
    lines = [f"{said}. {quality})."]
    if limit.next_rock_keeps is not None and limit.next_hundred is not None:
        low, high = limit.next_hundred
        line = f"It will do for about {100 * limit.next_rock_keeps:.0f} of the next hundred {place_word(s)}s (95 % interval {low} to {high})"
        if not share and limit.next_rock_no_worse is not None:
            with_default = exact_text(best.default_mean, cost)
            line += f"; on any one it is no worse than with {with_default} with probability {limit.next_rock_no_worse:.2f}"
        lines.append(f"{line}.")
    return lines


def _modelled_worth(best: Recommendation, s: CampaignSettings) -> list[str]:
    label, digits = metric_label(best.metric), _decimals(best.sd)
    said = f"{_short(label)} {label.value(best.mean, digits)}"
    if best.keep_default:
        lines = [
            f"{said} on the training {place_word(s)}s ({_interval(map(label.possible, best.interval_95), digits)})."
        ]
    else:
        of_gain = _decimals(best.improvement_sd)
        gain = with_unit(best.improvement, label.difference_unit, of_gain, signed=True)
        interval = _interval(best.improvement_interval_95, of_gain, signed=True)
        lines = [
            f"{said} in place of {label.value(best.default_mean, digits)} on the training {place_word(s)}s: {gain} ({interval})"
            f"{', positive where less' if best.direction == 'minimise' else ''}."
        ]
    if best.limit is not None:
        lines.append(_cost_sentence(best, best.limit))
    if (next_rock := best.next_rock) is not None:
        digits = _decimals((next_rock.interval_95[1] - next_rock.interval_95[0]) / 4)
        gain = with_unit(next_rock.gain, label.difference_unit, digits, signed=True)
        interval = _interval(next_rock.interval_95, digits, signed=True)
        lines.append(
            f"On the next {place_word(s)} {gain} ({interval}); no worse than the default with probability {next_rock.no_worse:.2f}."
        )
    return lines


def _cost_sentence(best: Recommendation, limit: Limit) -> str:
    label = metric_label(limit.metric)
    if limit.exact:
        has, default = (exact_text(mean, label) for mean in (limit.mean, limit.default_mean))
        said = f"{label.name} {has}"
    else:
        digits = _decimals(limit.sd)
        has, default = label.value(limit.mean, digits), label.value(limit.default_mean, digits)
        said = f"{label.name} {has} (kept with probability {limit.probability:.2f})"
    rest = "" if best.keep_default else f"; the default has {default}"
    return f"{said}, asked for {limit_words(limit).removeprefix(f'{_short(label)} ')}{rest}."


def runner_up_sentence(best: Recommendation, s: CampaignSettings) -> str:
    """What may be better and is not known to be; empty where there is nothing."""
    rival = best.runner_up
    if rival is None:
        return ""
    flown = f"flown {rival.missions} {'time' if rival.missions == 1 else 'times'}"
    label = metric_label(best.metric)
    if best.exact:
        worth = exact_text(rival.mean, label, label.name[:1].lower() + label.name[1:])
    else:
        digits = _decimals((rival.difference_interval_95[1] - rival.difference_interval_95[0]) / 4)
        gain = with_unit(rival.difference, label.difference_unit, digits, signed=True)
        interval = _interval(rival.difference_interval_95, digits, signed=True)
        worth = f"{gain} ({interval}) against the above"
    keeps = "" if rival.probability is None else f"; keeps the limit with probability {rival.probability:.2f}"
    return f"Runner-up ({flown}): {configuration_words(rival.values, best, s)}. {worth[:1].upper()}{worth[1:]}{keeps}."


# -- small things --------------------------------------------------------------------------------------------


def exact_text(value: float, label: MetricLabel, name: str = "") -> str:
    """``26 photographs``, ``12.5 s``: what a configuration decides, without an uncertainty."""
    text = f"{value:.0f}" if value == int(value) else f"{value:.4g}"
    return " ".join(filter(None, (text, label.unit or name)))


def limit_words(limit: Limit) -> str:
    """``F-score at least 98 %``; of a share, ``F-score 98 % on at least 95 % of rocks``."""
    if share := reached(limit.metric):
        return f"{_reach_words(share)} on {_bound_words(limit)} of rocks"
    return f"{_short(metric_label(limit.metric))} {_bound_words(limit)}"


def _bound_words(limit: Limit) -> str:
    bound = "at least" if limit.direction == "maximise" else "at most"
    return f"{bound} {metric_label(limit.metric).value(limit.limit, _digits(limit.limit))}"


def place_word(s: CampaignSettings) -> str:
    """What a campaign is tuned on: rocks, or the instances of a mission file."""
    return "rock" if s.mission is None else "instance"


def _short(label: MetricLabel) -> str:
    """``F-score`` of ``F-score @ 48 mm``."""
    return re.sub(r" @ [\d.]+ mm", "", label.name)


def _reach_words(share: tuple[str, float]) -> str:
    """``F-score 98 %``."""
    label = metric_label(share[0])
    return f"{_short(label)} {label.value(share[1], _digits(share[1]))}"


def _interval(interval: Iterable[float | None], digits: int, *, signed: bool = False) -> str:
    low, high = (format_number(value, digits, signed=signed) for value in interval)
    return f"95 % interval {low} to {high}"


def _decimals(sd: float) -> int:
    """One significant digit of the uncertainty."""
    return max(1, decimals_for(sd) - 1)


def _digits(value: float) -> int:
    return next((digits for digits in (0, 1) if round(value, digits) == value), 2)
