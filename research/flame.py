"""Where a mission's CPU time goes: a flame graph from samples of the Python stack, and the heaviest functions.

    OMP_NUM_THREADS=1 python -m research.flame [--rock boulder] [--preset campaign] [--folder docs/images] [--kinds cold new known]

Flies one mission per kind, each in a process of its own: with nothing cached (``cold``), with a warm store that has
not seen its sequence of views (``new``), and with one that has (``known``). A timer of the process's CPU time
interrupts every 5 ms; each sample weighs the CPU time since the one before, so that time spent inside a library is
charged to the Python function that called it, and other processes on the machine do not show.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import signal
import tempfile
import time
from collections import Counter
from pathlib import Path

from nbv.threads import single_thread_environment
from research.fresh_process import forget_sequences

INTERVAL_S = 0.005
MIN_SHARE = 0.004  # narrower boxes are left out
SAMPLER = f"{Path(__file__).parent.name}/{Path(__file__).stem}: take"
Stack = tuple[str, ...]


def sample(home: Path, rock: str, preset_name: str, sender) -> None:  # type: ignore[no-untyped-def]
    """Fly and send ``{stack: CPU seconds}``; runs in a process of its own."""
    from nbv.config import preset
    from nbv.photogrammetric import run_photogrammetric_mission

    seconds: Counter[Stack] = Counter()
    last = time.process_time()

    def take(signum, frame) -> None:  # type: ignore[no-untyped-def]
        nonlocal last
        now = time.process_time()
        stack = []
        while frame is not None:
            path = Path(frame.f_code.co_filename)
            stack.append(f"{path.parent.name}/{path.stem}: {frame.f_code.co_name}")
            frame = frame.f_back
        seconds[tuple(reversed(stack))] += now - last
        last = now

    signal.signal(signal.SIGPROF, take)
    signal.setitimer(signal.ITIMER_PROF, INTERVAL_S, INTERVAL_S)
    run_photogrammetric_mission(preset(preset_name), rock, 0)
    signal.setitimer(signal.ITIMER_PROF, 0, 0)
    sender.send(dict(seconds))


def from_mission(stacks: dict[Stack, float]) -> dict[Stack, float]:
    """Without what lies outside ``fly_mission``, and without comprehensions' own frames."""
    found: Counter[Stack] = Counter()
    for stack, value in stacks.items():
        starts = [i for i, name in enumerate(stack) if name.endswith(": fly_mission")]
        if starts:
            inside = stack[starts[0] :]
            if SAMPLER in inside:  # a sample that fell into the sampler itself
                inside = inside[: inside.index(SAMPLER)]
            found[tuple(n for n in inside if "<" not in n)] += value
    return dict(found)


def draw(stacks: dict[Stack, float], title: str, path: Path) -> None:
    """Boxes as wide as their share of the CPU time, callers below."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    total = sum(stacks.values())
    figure, axis = plt.subplots(figsize=(15, 6.5), layout="constrained")
    deepest = 0

    def place(items: list[tuple[Stack, float]], depth: int, left: float) -> None:
        nonlocal deepest
        groups: dict[str, list[tuple[Stack, float]]] = {}
        for stack, value in items:
            if len(stack) > depth:
                groups.setdefault(stack[depth], []).append((stack, value))
        for name, members in sorted(groups.items()):
            width = sum(value for _, value in members)
            if width < MIN_SHARE * total:
                continue
            deepest = max(deepest, depth)
            shade = (hash_of(name) % 100) / 100
            axis.barh(
                depth,
                width,
                left=left,
                height=0.96,
                color=plt.cm.YlOrRd(0.15 + 0.5 * shade),
                edgecolor="white",
                linewidth=0.5,
            )
            module, function = name.split(": ")
            room = int(width / total * 190)
            text = f"{function} ({module.split('/')[-1]}) {width:.2f} s"
            text = text if len(text) <= room else function[: max(room, 0)]
            if len(text) > 2:
                axis.text(left + width / 2, depth, text, ha="center", va="center", fontsize=7)
            place(members, depth + 1, left)
            left += width

    place(sorted(stacks.items()), 0, 0.0)
    axis.set_xlim(0, total)
    axis.set_ylim(-0.5, deepest + 0.6)
    axis.set_yticks([])
    axis.set_xlabel("CPU seconds")
    axis.set_title(title, fontsize=10)
    for side in ("top", "right", "left"):
        axis.spines[side].set_visible(False)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def hash_of(name: str) -> int:
    """The same colour for a function in every graph."""
    import zlib

    return zlib.crc32(name.encode())


def heaviest(stacks: dict[Stack, float], count: int = 14) -> list[tuple[str, float]]:
    """Functions of this project by CPU time spent in them or in libraries they call."""
    own: Counter[str] = Counter()
    rooms = {p.name for p in Path(__file__).resolve().parent.parent.joinpath("nbv").iterdir() if p.is_dir()}
    for stack, value in stacks.items():
        inner = [name for name in stack if name.split("/")[0] in rooms | {"nbv"}]
        if inner:
            own[inner[-1]] += value
    return own.most_common(count)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rock", default="boulder")
    parser.add_argument("--preset", default="campaign")
    parser.add_argument(
        "--kinds", nargs="+", choices=["cold", "new", "known"], default=["cold", "new", "known"]
    )
    parser.add_argument(
        "--home", type=Path, help="rocks, caches and store, needed for new or known without cold"
    )
    parser.add_argument("--folder", type=Path, help="where flame_PRESET_KIND.png go")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    single_thread_environment()
    report = {}
    with tempfile.TemporaryDirectory(prefix="flame-") as name:
        home = arguments.home or Path(name) / "home"
        os.environ["GATETUNE_HOME"] = str(home)
        for kind in arguments.kinds:
            if kind == "new":
                forget_sequences(home)
            context = multiprocessing.get_context("spawn")
            receiver, sender = context.Pipe(duplex=False)
            child = context.Process(target=sample, args=(home, arguments.rock, arguments.preset, sender))
            child.start()
            sender.close()
            stacks = from_mission(receiver.recv())
            child.join()
            total = sum(stacks.values())
            print(f"\n{arguments.preset} mission on {arguments.rock}, {kind}: {total:.2f} s CPU\n")
            print("| function, with the libraries it calls | CPU s | share |\n|---|---|---|")
            for function, value in heaviest(stacks):
                print(f"| {function} | {value:.2f} | {100 * value / total:.0f} % |", flush=True)
            report[kind] = {"total_s": total, "functions": heaviest(stacks, 400)}
            if arguments.folder:
                title = {
                    "cold": "nothing cached",
                    "new": "warm store, new sequence of views",
                    "known": "warm store, known sequence of views",
                }[kind]
                draw(
                    stacks,
                    f"{arguments.preset} mission on {arguments.rock}, {title}: {total:.1f} CPU s",
                    arguments.folder / f"flame_{arguments.preset}_{kind}.png",
                )
    if arguments.out:
        arguments.out.write_text(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
