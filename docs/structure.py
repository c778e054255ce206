"""How the repository is laid out, in numbers: files per level, import circles, lines, options; and what has grown large.

    python docs/structure.py [--root DIR]

``--root`` names another checkout of this project to count. Circles are the strongly connected components of the
import graph of the modules. Imports inside functions and for type checking count, and so do modules that a text names for
a later import: ``importlib.import_module("nbv.gates")``, or a reference ``"nbv.gates.registry:OracleGate"``.
"""

from __future__ import annotations

import argparse
import ast
from pathlib import Path

import networkx as nx

LONG_FILE, MANY_FILES, README_WORDS, DOCS_BYTES = 400, 16, 500, 100 * 1024
PRINTED = ("commands.md", "parameters.md")  # printed from the code; nobody reads them through


def modules(root: Path) -> dict[str, Path]:
    """Every module of both packages by its dotted name."""
    found = {}
    for package in ("nbv", "tuner"):
        for path in sorted((root / package).rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(root: Path) -> nx.DiGraph:
    """An edge from each module to every module of the project that it imports, anywhere in it."""
    known = modules(root)
    graph = nx.DiGraph()
    graph.add_nodes_from(known)
    for name, path in known.items():
        for node in ast.walk(ast.parse(path.read_text())):
            targets: list[str] = []
            if isinstance(node, ast.ImportFrom) and node.module and not node.level:
                for alias in node.names:
                    submodule = f"{node.module}.{alias.name}"
                    targets.append(submodule if submodule in known else node.module)
            elif isinstance(node, ast.Import):
                targets = [alias.name for alias in node.names]
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                module, colon, attribute = node.value.partition(":")
                targets = [module] if colon and attribute.isidentifier() else []
            elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
                targets = [
                    a.value for a in node.args if isinstance(a, ast.Constant) and isinstance(a.value, str)
                ]
            graph.add_edges_from((name, target) for target in targets if target in known and target != name)
    return graph


def lines(root: Path, *folders: str, suffix: str = ".py") -> int:
    """Lines of all files with ``suffix`` below ``folders``."""
    files = [path for folder in folders for path in (root / folder).rglob(f"*{suffix}")]
    return sum(len(path.read_text().splitlines()) for path in files)


def statements(root: Path, folder: str) -> int:
    """Python statements below a folder: a measure of code that no formatter changes."""
    files = (root / folder).rglob("*.py")
    return sum(isinstance(node, ast.stmt) for path in files for node in ast.walk(ast.parse(path.read_text())))


def function_imports(root: Path) -> int:
    """Import statements inside functions."""
    count = 0
    for path in modules(root).values():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                count += sum(isinstance(inner, (ast.Import, ast.ImportFrom)) for inner in ast.walk(node))
    return count


def options_of_campaign_run(root: Path) -> int:
    """Options of ``gatetune campaign run``; its arguments are not counted."""
    tree = ast.parse((root / "tuner/commands/campaign.py").read_text())
    run = next(n for n in tree.body if isinstance(n, ast.FunctionDef) and n.name == "run")
    return sum("typer.Option" in ast.unparse(a.annotation) for a in run.args.args if a.annotation is not None)


def large(root: Path) -> list[str]:
    """What is larger than a reader likes, a line each. Nothing fails for it."""
    found = []
    for name, path in modules(root).items():
        if (count := len(path.read_text().splitlines())) > LONG_FILE:
            found.append(f"{name} has {count} lines")
        if path.name == "__init__.py" and (count := len([*path.parent.glob("*.py")])) > MANY_FILES:
            found.append(f"room {name} has {count} files")
    if (words := len((root / "README.md").read_text().split())) > README_WORDS:
        found.append(f"README.md has {words} words")
    written = [page for page in (root / "docs").rglob("*.md") if page.name not in PRINTED]
    if (size := sum(page.stat().st_size for page in written)) > DOCS_BYTES:
        found.append(f"docs/ has {size / 1024:.0f} KB of Markdown")
    return found


def main() -> None:
    """Print the counts as a Markdown table, and what is large."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--root", type=Path, default=Path(__file__).resolve().parent.parent)
    root = parser.parse_args().root
    graph = imports(root)
    circles = sorted((len(c) for c in nx.strongly_connected_components(graph) if len(c) > 1), reverse=True)
    docs = [*(root / "docs").rglob("*.md")]
    rows = {
        "files on the top level of tuner/": len([*(root / "tuner").glob("*.py")]),
        "files on the top level of nbv/": len([*(root / "nbv").glob("*.py")]),
        "most files in one room": max(
            len([*d.glob("*.py")]) for d in root.glob("*/*/") if d.parts[-2] in ("nbv", "tuner")
        ),
        "import circles (files in each)": ", ".join(map(str, circles)) or "none",
        "imports inside functions": function_imports(root),
        "longest file (lines)": max(len(p.read_text().splitlines()) for p in modules(root).values()),
        "statements of nbv/": statements(root, "nbv"),
        "statements of tuner/": statements(root, "tuner"),
        "statements of tests/": statements(root, "tests"),
        "lines of nbv/": lines(root, "nbv"),
        "lines of tuner/": lines(root, "tuner"),
        "lines of tests/": lines(root, "tests"),
        "lines of research/": lines(root, "research"),
        "docs, kB of Markdown": round(sum(p.stat().st_size for p in docs) / 1000),
        "README, words": len((root / "README.md").read_text().split()),
        "options of `campaign run`": options_of_campaign_run(root),
    }
    print("| | |\n|---|---:|")
    for name, value in rows.items():
        print(f"| {name} | {value} |")
    for line in large(root):
        print(f"large: {line}")


if __name__ == "__main__":
    main()
