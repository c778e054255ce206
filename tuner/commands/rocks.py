"""``gatetune rocks list|show|import``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from nbv.cache import Store
from nbv.errors import UserError
from nbv.rocks import describe, import_mesh, list_rocks, load_rock, save_imported
from tuner.commands.console import AsJson, answer_json, output, show_table, working

app = typer.Typer(no_args_is_help=True)


@app.command("list")
def list_(
    split: Annotated[str | None, typer.Option(help="train, held-out or extra.")] = None,
    as_json: AsJson = False,
) -> None:
    """List the catalogue: procedural and imported rocks.

    Example: gatetune rocks list --split train
    """
    rocks = [info for info in list_rocks() if split is None or info.split == split]
    rows = [(info.name, info.split, info.source, info.difficulty) for info in rocks]
    show_table(("rock", "split", "source", "what makes it hard"), rows)
    answer_json(rocks)


@app.command()
def show(
    rock: Annotated[
        str, typer.Argument(help="Catalogue name, FAMILY-SEED of a drawn rock, or path of a mesh.")
    ],
    image: Annotated[Path | None, typer.Option(help="Also render a contact sheet into this PNG.")] = None,
    as_json: AsJson = False,
) -> None:
    """Show size, area, overhangs and what the importer changed; with --image, a picture.

    Example: gatetune rocks show slab --image slab.png
    """
    from nbv.config import EvaluationConfig
    from nbv.evaluation.ground_truth import ground_share

    subject = load_rock(rock, Store())
    facts: dict[str, object] = {
        "name": subject.name,
        "split": subject.split,
        "difficulty": subject.difficulty,
    }
    facts |= {**describe(subject), "ground_fraction": ground_share(subject, EvaluationConfig())}
    facts["sha256"] = subject.sha256
    rows = [(fact, f"{value:.3f}" if isinstance(value, float) else value) for fact, value in facts.items()]
    show_table(("fact", "value"), [*rows, *(("note", note) for note in subject.notes)], subject.name)
    if image is not None:
        from PIL import Image

        from nbv.scene import preview

        picture = Image.fromarray(preview(subject, store=Store()))
        try:
            picture.save(image)
        except (OSError, ValueError) as error:  # ValueError: unknown image format
            raise UserError(f"cannot write {image}: {error}; name a .png in a folder that exists") from error
        output.print(f"contact sheet: {image}")
    answer_json({**facts, "notes": subject.notes, "contact_sheet": image})


@app.command("import")
def import_(
    mesh: Annotated[Path, typer.Argument(help="A mesh: OBJ+MTL+texture, GLB, glTF, PLY, STL or OFF.")],
    name: Annotated[str | None, typer.Option(help="Catalogue name (default: the file's).")] = None,
    split: Annotated[str, typer.Option(help="train, held-out or extra.")] = "train",
    height_m: Annotated[float, typer.Option(help="Scale the rock to this height.")] = 1.6,
    up: Annotated[str, typer.Option(help="The file's up axis: auto, x, y, z, -x, -y or -z.")] = "auto",
    body: Annotated[
        int | None, typer.Option(help="One body alone, 1 the one of most surface; all without it.", min=1)
    ] = None,
    force: Annotated[bool, typer.Option(help="Replace a rock of the same name.")] = False,
) -> None:
    """Import a mesh into the catalogue and print what was changed.

    Example: gatetune rocks import scan.glb --name mine --up z
    """
    from nbv.config import EvaluationConfig
    from nbv.evaluation.ground_truth import ground_share

    output.print(f"importing {mesh}")
    checked: dict[str, Any] = {"split": split}  # import_mesh refuses other words
    with working(f"preparing {mesh.name}"):
        subject = import_mesh(mesh, name=name, height_m=height_m, up=up, body=body, **checked)
        save_imported(subject, force=force)
    output.print(f"imported {subject.name} ({subject.split}): {len(subject.faces)} faces")
    for note in subject.notes:
        output.print(f"  - {note}")
    if share := ground_share(subject, EvaluationConfig()):
        output.print(
            f"  - ground: {100 * share:.1f} % of the surface, which is not measured: cleaning takes it off a cloud too"
        )
