"""``python -m research.learn_gate``: a switching policy from missions' logs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from research.study_command import run
from tuner.commands.console import output


def learn_gate(
    runs: Annotated[list[Path], typer.Argument(help="Missions, or directories with missions below them.")],
    out: Annotated[Path, typer.Option(help="The policy file.")] = Path("policy.json"),
    without: Annotated[
        list[str] | None, typer.Option(help="Rock whose missions are left out, repeatable.")
    ] = None,
    oracle: Annotated[
        str | None, typer.Option(help="Only missions judged by this gate.oracle_coverage.")
    ] = None,
    max_depth: Annotated[int, typer.Option(help="Of the decision tree.")] = 3,
    seed: Annotated[int, typer.Option(help="Breaks ties between equally good splits.")] = 0,
) -> None:
    """Train the learned gate from what the oracle thought of both scorers' choices; cross-validated by rock.

    Example: python -m research.learn_gate runs/mine --out policy.json
    """
    from research.flown_missions import find_missions
    from research.gate_learning import describe_tree, gate_decisions, judged_by, without_rocks
    from research.gate_learning import learn_gate as learn

    missions = without_rocks(find_missions(runs), without or [])
    decisions = gate_decisions(judged_by(missions, oracle) if oracle is not None else missions)
    counts = decisions.counts
    output.print(
        f"{decisions.missions} missions on {len(set(decisions.rocks))} rocks, {len(decisions.rewards)} decisions "
        f"(oracle: {decisions.coverage}): it prefers covis in {counts['covis']}, b-aware in {counts['b-aware']}, "
        f"is indifferent in {counts['tie']}, "
        f"in {decisions.same_view} of these because both scorers choose the same view"
    )
    for number, why in (
        (decisions.duplicates, "the same decision again"),
        (decisions.incomplete, "incomplete"),
    ):
        if number:
            output.print(f"{number} log records left out: {why}")
    policy = learn(decisions, max_depth, seed)
    if policy.scores:
        table = Table(title="On rocks left out of the training")
        table.add_column("policy")
        for column in (
            "agrees with the oracle",
            "samples lost per decision",
            "of the oracle's gain over Covis",
        ):
            table.add_column(column, justify="right")
        for score in policy.scores:
            table.add_row(
                score.name,
                "–" if score.accuracy is None else f"{100 * score.accuracy:.1f} %",
                f"{score.regret:.1f}",
                "–" if score.gain_share is None else f"{100 * score.gain_share:.0f} %",
            )
        output.print(table)
    for line in describe_tree(policy.root):
        output.print(line, highlight=False)
    for note in policy.notes:
        output.print(f"note: {note}")
    policy.save(out)
    output.print(f"policy: {out}; fly it with --set gate.kind=learned --set gate.learned_policy={out}")


if __name__ == "__main__":
    run(learn_gate)
