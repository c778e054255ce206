"""`make fuzz`: damaged and made-up files through every parser, and the command line; a table of how each case ended.

Each target reads one file or one list of arguments. Its seeds are what this program writes itself; a case is a seed after a few
mutations drawn from (target, number), so that ``--only TARGET:NUMBER`` repeats it. Cases run in child processes with limits
on memory (2 GB more than at the start) and on time (10 s of computing or 60 s in all). What is neither read nor refused in one line is a finding.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import multiprocessing
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from research import write_rows

# Before numpy and torch are loaded: a process with threads cannot be forked.
os.environ["OMP_NUM_THREADS"] = "1"
ROOT = Path(__file__).resolve().parents[1]
CORPUS = ROOT / "tests" / "data" / "fuzz"
TIME_LIMIT_S = 20  # the finest mesh that an import makes, of 2.4 million faces, takes 12
MEMORY_LIMIT = 2 * 2**30
FIRST_BATCH, TURN_S = 25, 3.0
OUTCOMES = ("read", "refused", "traceback", "hang", "memory", "died", "escaped")
TOKENS = [
    *(b"\x00", b"\xff\xfe", b"\n", b"{", b"}", b"[", b"]", b":", b"- ", b"&a ", b"*a", b"<<: *a"),
    *(b"!!python/name:os.system ", b"-1", b"0", b"1e999", b"nan", b".inf", b"-0.0", b"1e-320"),
    *(b"99999999999999999999", b"true", b"null", b"''", b"2001-01-01", b"../../x", b"/dev/zero"),
    *(b"/dev/stdin", b"~nobody/x", b"[/red]", b"\xed\xa0\x80", "\u202e".encode(), b"a" * 5000, b"[" * 200),
]


def _settings(path: Path) -> None:
    from tuner.campaign.settings_file import read_settings_file, settings_from_dict

    settings_from_dict(read_settings_file(path), str(path))


def _space(path: Path) -> None:
    from tuner.problem.space_files import load_search_space

    load_search_space(path)


def _condition(path: Path) -> None:
    from nbv.config import load_condition, preset, under

    under(preset("campaign"), load_condition(str(path)))


def _config(path: Path) -> None:
    from nbv.config import config_from_dict
    from nbv.safe_files import read_yaml

    config_from_dict(read_yaml(path))


def _mission_result(path: Path) -> None:
    from nbv.mission.result import MissionResult

    MissionResult.load(path.parent)


def _rock(path: Path) -> None:
    from nbv.rocks.catalogue import read_rock

    read_rock(path)


def _mesh(path: Path) -> None:
    from nbv.rocks.importer import import_mesh

    import_mesh(path)


def _texture(path: Path) -> None:
    from nbv.rocks.importer import import_mesh

    path.with_name("beside.mtl").write_text(f"newmtl a\nmap_Kd {path.name}\n")
    mesh = path.with_name("beside.obj")
    mesh.write_text(TEXTURED)
    import_mesh(mesh)


def _photograph(path: Path) -> None:
    from nbv.photographs.folder import read_folder, read_pixels

    folder = path.parent / "photographs"
    shutil.copytree(FLOWN.parent / "photographs", folder)
    shutil.copy(path, folder)
    for photograph in read_folder(folder, lambda *_: None)[0]:
        read_pixels(photograph.path, 64, photograph.quarters(upright=True))


def _mask(path: Path) -> None:
    from nbv.photographs.import_source import read_mask

    read_mask(path)


def _model(path: Path) -> None:
    """A file of a model, whose name is the first line; the others of its kind are sound."""
    from nbv.photographs.sparse_model import solve

    name, _, content = path.read_bytes().partition(b"\n")
    file = path.parent / "model" / (name.decode() if name in MODEL_FILES else MODEL_FILES[0].decode())
    shutil.copytree(FLOWN.parent / f"model{file.suffix}", file.parent)
    file.write_bytes(content)
    solve(_source(), file.parent)


def _source() -> Any:
    from nbv.photographs.folder import read_folder
    from nbv.photographs.import_source import ImportSource

    photographs, _ = read_folder(FLOWN.parent / "photographs", lambda *_: None)
    return ImportSource(tuple(photographs), 160, lambda *_: None)


def _photograph_set(path: Path) -> None:
    from nbv.photographs.photograph_set import read_set

    folder = path.parent / "set"
    shutil.copytree(FLOWN.parent / "set", folder)
    shutil.copy(path, folder)
    read_set(folder).reference()


def _full_disk(path: Path) -> None:
    """A command, and how many blocks of 4 KiB are left for it in a file system of its own."""
    command, _, blocks = path.read_bytes().rpartition(b"\0")
    disk = path.parent / "disk"
    disk.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64m", "fuzz", str(disk)], check=True)
    try:
        for name in ("flown", "mission", "home", "tetra.obj"):
            subprocess.run(["cp", "-r", str(FLOWN.parent / name), str(disk)], check=True)
        (disk / "arguments").write_bytes(command)
        os.environ["GATETUNE_HOME"] = str(disk / "home")
        left = os.statvfs(disk)
        with (disk / "filler").open("wb") as filler:
            os.posix_fallocate(filler.fileno(), 0, max(1, left.f_bavail - int(blocks)) * left.f_bsize)
        _command_line(disk / "arguments")
    finally:
        os.chdir(path.parent)
        subprocess.run(["umount", "-l", str(disk)], check=True)


def _store(path: Path) -> None:
    import numpy as np

    from nbv.cache import Store

    store = Store(path.parent / "store")
    place = store.root / "kind" / "ab" / "abcd"
    place.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(path, place)
    held = store.get("kind", "abcd")  # bytes beside the content, such as a date, may be others
    whole = np.load(io.BytesIO(SEEDS["store entry"][0]))
    assert held is None or all(np.array_equal(held[name], whole[name]) for name in whole.files)


def _campaign(name: str) -> Callable[[Path], None]:
    def read(path: Path) -> None:
        from tuner.campaign.campaign import Campaign

        run = path.parent / "run"
        shutil.rmtree(run, ignore_errors=True)
        shutil.copytree(FLOWN, run)
        shutil.copy(path, run / name)
        Campaign.open(run, read_only=True).recommendation(save=False)

    return read


def _command_line(path: Path) -> None:
    from tuner.cli import main

    arguments = [part.decode(errors="surrogateescape") for part in path.read_bytes().split(b"\0")]
    if {"run", "evaluate", "reproduce"} & set(arguments):  # no rock is made
        arguments += ["--rock", "no-such-rock"] if arguments[0] != "mission" else []
    sys.argv = ["gatetune", *arguments]
    os.chdir(path.parent)
    try:
        main()
    except SystemExit as error:
        log = path.parent / "home" / "last_error.log"
        if error.code == 70:
            raise RuntimeError(log.read_text(errors="replace") if log.is_file() else "exit 70") from None
        if error.code not in (0, 1, None):
            from nbv.errors import UserError

            raise UserError("exit status 2") from None


TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
TEXTURED = (
    "mtllib beside.mtl\nusemtl a\nvt 0 0\nvt 1 0\nvt 0 1\nvt 1 1\n"
    "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1/1 3/3 2/2\nf 1/1 2/2 4/4\nf 2/2 3/3 4/4\nf 1/1 4/4 3/3\n"
)
ARGUMENTS = [
    line.split()
    for line in (
        "campaign run --budget 2 --replicates 1 --name x --rock boulder --seed 1",
        "campaign run --settings x.yaml --set gate.d95_m=0.1 --fidelity geometric",
        "campaign status run",
        "campaign resume nowhere --missions 3 --workers 1",
        "mission explain run",
        "mission figures run",
        "rocks list",
        "rocks show no-such-rock",
        "rocks import x.obj --name x",
        "config show campaign",
        "config paths",
        "export run --to x.yaml",
        "evaluate run --rock fin",
        "--version",
    )
]
FILLING = [
    line.split()
    for line in (
        "mission view flown",
        "mission view mission",
        "mission explain mission",
        "mission init own",
        "mission run --fidelity geometric --rock boulder --out new --set photographs=26",
        "export flown --to csv",
        "export flown --to gatetune.yaml --anyway",
        "export mission --to plan --home 47,8",
        "campaign status flown",
        "plugin init mine",
        "rocks import tetra.obj --name mine",
    )
]
MODEL_FILES = [
    f"{name}.{end}".encode() for end in ("bin", "txt") for name in ("cameras", "images", "points3D")
]
DISK = "full disk"

SEEDS: dict[str, list[bytes]] = {}
TARGETS: dict[str, tuple[str, Callable[[Path], None]]] = {
    "settings file": ("x.yaml", _settings),
    "search space": ("x.yaml", _space),
    "condition": ("x.yaml", _condition),
    "configuration": ("x.yaml", _config),
    "mission.json": ("mission.json", _mission_result),
    "rock": ("rock.npz", _rock),
    "mesh OBJ": ("m.obj", _mesh),
    "mesh PLY": ("m.ply", _mesh),
    "mesh STL": ("m.stl", _mesh),
    "mesh GLB": ("m.glb", _mesh),
    "texture": ("t.png", _texture),
    "photograph": ("x.jpg", _photograph),
    "mask": ("x.png", _mask),
    "model of photographs": ("model file", _model),
    "set of photographs": ("set.json", _photograph_set),
    "store entry": ("entry", _store),
    "campaign.yaml": ("campaign.yaml", _campaign("campaign.yaml")),
    "command line": ("arguments", _command_line),
    DISK: ("filling", _full_disk),
}
if os.geteuid():  # who may not mount a file system
    del TARGETS[DISK]
FLOWN = Path()


def make_seeds(folder: Path) -> None:
    """Files of every kind, written by this program."""
    global FLOWN
    sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "support")]
    import fake_campaigns
    import numpy as np
    import trimesh
    import yaml
    from PIL import Image

    from nbv.cache import Store
    from nbv.config import preset
    from nbv.geometric import run_geometric_mission
    from nbv.rocks.catalogue import write_rock
    from nbv.rocks.importer import import_mesh

    FLOWN = folder / "flown"
    fake_campaigns.run(FLOWN, sampler="sobol", budget=3).recommendation()
    SEEDS["campaign.yaml"] = [(FLOWN / "campaign.yaml").read_bytes()]
    settings = yaml.safe_load(SEEDS["campaign.yaml"][0])["settings"] | {
        "fidelity": "geometric",
        "rocks": ["boulder"],
    }
    small = b"rocks: [boulder, slab]\nbudget: 8\nspace: gate\nconditions: [ideal, field]\nname: x\n"
    SEEDS["settings file"] = [yaml.safe_dump(settings).encode(), small]
    SEEDS["search space"] = [p.read_bytes() for p in sorted((ROOT / "search_spaces").glob("*.yaml"))]
    SEEDS["condition"] = [p.read_bytes() for p in sorted((ROOT / "conditions").glob("*.yaml"))]
    SEEDS["configuration"] = [yaml.safe_dump(preset("campaign").to_dict()).encode()]
    SEEDS["mission.json"] = [next(FLOWN.glob("missions/*/mission.json")).read_bytes()]
    obj = folder / "tetra.obj"
    obj.write_text(TETRAHEDRON)
    write_rock(import_mesh(obj), folder / "rock.npz")
    SEEDS["rock"] = [(folder / "rock.npz").read_bytes()]
    ball = trimesh.creation.icosphere(1)
    with_material = b"mtllib m.mtl\nusemtl a\n" + TETRAHEDRON.encode().replace(
        b"f 1 3 2", b"vt 0 1\nf 1/1 3/1 2/1"
    )
    SEEDS["mesh OBJ"] = [TETRAHEDRON.encode(), with_material]
    SEEDS["mesh PLY"] = [ball.export(file_type="ply"), ball.export(file_type="ply", encoding="ascii")]
    SEEDS["mesh STL"] = [ball.export(file_type="stl"), ball.export(file_type="stl_ascii").encode()]
    SEEDS["mesh GLB"] = [ball.export(file_type="glb")]
    picture = Image.fromarray(np.random.default_rng(0).integers(0, 255, (8, 8, 3), dtype=np.uint8))
    SEEDS["texture"] = []
    for kind in ("PNG", "JPEG", "BMP", "TIFF"):
        buffer = io.BytesIO()
        picture.save(buffer, kind)
        SEEDS["texture"].append(buffer.getvalue())
    _photographs(folder)
    store = Store(folder / "store")
    store.put("kind", "abcd", {"a": np.arange(20.0)})
    SEEDS["store entry"] = [(store.root / "kind" / "ab" / "abcd").read_bytes()]
    SEEDS["command line"] = ["\0".join(a).encode() for a in ARGUMENTS]
    os.environ["GATETUNE_HOME"] = str(folder / "home")
    (folder / "home").mkdir(exist_ok=True)  # a mission that finds its rock in a cache makes none
    few = preset("campaign").with_values({"photographs": 26})
    run_geometric_mission(few, "boulder", 0, folder / "mission")
    SEEDS[DISK] = ["\0".join([*a, "8000"]).encode() for a in FILLING]
    for target in TARGETS:
        SEEDS[target] += [p.read_bytes() for p in sorted((CORPUS / folder_of(target)).glob("*"))]


def _photographs(folder: Path) -> None:
    """A ball's, a model, masks and a set."""
    import drawn_ball
    import photographed_ball
    from PIL import Image

    photographs = drawn_ball.write_photographs(folder / "photographs", "PINHOLE", 6)
    made = sorted(photographs.iterdir())
    SEEDS["photograph"] = [made[0].read_bytes()]
    for number, mode in enumerate(("RGB", "L", "CMYK")):
        exif = Image.Exif()
        exif[0x0110], exif[0x0112] = "Made", 6 + number % 3
        exif.get_ifd(0x8769).update(
            {0x9003: "2026:01:01 12:00:00", 0xA405: 30, 0xA432: (24.0, 70.0, 2.8, 4.0)}
        )
        exif.get_ifd(0x8825).update({1: "N", 2: (46.0, 7.0, 1.5), 3: "E", 4: (7.0, 1.0, 2.0), 6: 400.0})
        buffer = io.BytesIO()
        Image.open(made[1]).convert(mode).save(buffer, "JPEG", exif=exif)
        SEEDS["photograph"].append(buffer.getvalue())
    SEEDS["mask"] = []
    mask = Image.fromarray(drawn_ball.drawn("PINHOLE")[0][1])
    for mode in ("1", "L", "P", "RGBA", "I;16"):
        buffer = io.BytesIO()
        mask.convert("L").convert(mode).save(buffer, "PNG")
        SEEDS["mask"].append(buffer.getvalue())
    model = drawn_ball.model("PINHOLE", 6)
    for kind in ("bin", "txt"):
        (folder / f"model.{kind}").mkdir()
    model.write_binary(folder / "model.bin")
    model.write_text(folder / "model.txt")
    SEEDS["model of photographs"] = [
        name + b"\n" + (folder / f"model{Path(name.decode()).suffix}" / name.decode()).read_bytes()
        for name in MODEL_FILES
    ]
    os.environ["GATETUNE_HOME"] = str(folder / "of the set")
    shutil.copytree(photographed_ball.write_part_of_a_set().folder, folder / "set")
    SEEDS["set of photographs"] = [(folder / "set" / "set.json").read_bytes()]


def folder_of(target: str) -> str:
    """The folder of a target's corpus."""
    return re.sub(r"[^a-z]+", "_", target.lower()).strip("_")


# -- cases ----------------------------------------------------------------------------------------------------


def case(target: str, number: int) -> bytes:
    """Input ``number`` of a target: the seeds as they are, then mutations of them."""
    seeds = SEEDS[target]
    if number < len(seeds):
        return seeds[number]
    rng = random.Random(f"{target}:{number}")
    if target == DISK:
        return b"%s\0%d" % (rng.choice(seeds).rpartition(b"\0")[0], int(2 ** rng.uniform(0, 12)))
    data = bytearray(rng.choice(seeds))
    for _ in range(1 + int(rng.expovariate(0.7))):
        _mutate(rng, data, seeds)
    return bytes(data[: 2**20])


def _mutate(rng: random.Random, data: bytearray, seeds: list[bytes]) -> None:
    place = rng.randrange(len(data) + 1)
    end = min(len(data), place + 1 + int(rng.expovariate(0.05)))
    match rng.randrange(9):
        case 0 if data:
            data[place % len(data)] ^= 1 << rng.randrange(8)
        case 1 if data:
            data[place % len(data)] = rng.randrange(256)
        case 2:
            del data[place:end]
        case 3:
            data[place:place] = data[place:end] * rng.choice([1, 2, 50])
        case 4:
            data[place:end] = rng.choice(TOKENS)
        case 5:
            data[place:place] = rng.choice(TOKENS)
        case 6:
            del data[place:]
        case 7:
            other = rng.choice(seeds)
            data[place:end] = other[rng.randrange(len(other) + 1) :][: 1 + int(rng.expovariate(0.02))]
        case _:  # a number of the text for another one
            found = list(re.finditer(rb"-?\d+(\.\d+)?", bytes(data)))[:2000]
            if found:
                which = rng.choice(found)
                data[which.start() : which.end()] = rng.choice(TOKENS)


class _HangError(BaseException):
    pass


def run_case(target: str, data: bytes, folder: Path) -> tuple[str, str]:
    """How one case ended, and its last lines where that is a finding."""
    from nbv.errors import UserError

    name, read = TARGETS[target]
    work = folder / "case"
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir()
    os.environ["GATETUNE_HOME"] = str(work / "home")
    (work / name).write_bytes(data)
    before = set(folder.iterdir())

    def late(*_: object) -> None:
        raise _HangError

    for number in (signal.SIGALRM, signal.SIGPROF):
        signal.signal(number, late)
    signal.setitimer(signal.ITIMER_PROF, TIME_LIMIT_S)  # of computing: a busy machine is not a hang
    signal.alarm(6 * TIME_LIMIT_S)
    outcome, what = "read", ""
    try:
        read(work / name)
    except UserError as error:
        outcome = "refused"
        if len(str(error).splitlines()) > 1:
            outcome, what = "traceback", f"a message of several lines: {error}"
    except _HangError:
        outcome, what = "hang", traceback.format_exc()
    except MemoryError:
        outcome, what = "memory", traceback.format_exc()
    except BaseException:
        outcome, what = "traceback", traceback.format_exc()
    finally:
        signal.alarm(0)
        signal.setitimer(signal.ITIMER_PROF, 0)
    if set(folder.iterdir()) - before:
        outcome, what = "escaped", str(set(folder.iterdir()) - before)
    return outcome, what[-3000:]


def _batch(target: str, first: int, count: int, folder: str, pipe: Any) -> None:
    """In a child: cases one after the other, each announced before it begins."""
    quiet = os.open(os.devnull, os.O_WRONLY)
    for descriptor in (1, 2):
        os.dup2(quiet, descriptor)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY_LIMIT, used + MEMORY_LIMIT))
    resource.setrlimit(resource.RLIMIT_FSIZE, (2**28, 2**28))
    for number in range(first, first + count):
        pipe.send(("begin", number, ""))
        outcome, what = run_case(target, case(target, number), Path(folder))
        pipe.send((outcome, number, what))
    pipe.close()


def run_batch(target: str, first: int, count: int, folder: Path) -> list[tuple[str, int, str]]:
    """Outcomes of ``count`` cases; the batch goes on in a new child where a case ends one."""
    found: list[tuple[str, int, str]] = []
    end = first + count
    while first < end:
        inner = Path(tempfile.mkdtemp(dir=folder))
        here, there = multiprocessing.Pipe(duplex=False)
        child = multiprocessing.get_context("fork").Process(
            target=_batch, args=(target, first, end - first, str(inner), there)
        )
        child.start()
        there.close()
        current = first
        try:
            while True:
                if not here.poll(12 * TIME_LIMIT_S):
                    child.kill()
                    found.append(("hang", current, "in compiled code"))
                    break
                outcome, current, what = here.recv()
                if outcome != "begin":
                    found.append((outcome, current, what))
        except EOFError:
            child.join()
            if current < end - 1 or len(found) == 0 or found[-1][1] != current:
                found.append(("died", current, f"exit {child.exitcode}"))
        child.join()
        shutil.rmtree(inner, ignore_errors=True)
        first = current + 1
    return found


def fuzz(targets: list[str], seconds: float, cases: int | None, out: Path | None) -> dict[str, Counter[str]]:
    """Cases of each target in turn, of each for the same time, until time or number (``cases`` of each) is used up."""
    table: dict[str, Counter[str]] = {t: Counter() for t in targets}
    spent_s = dict.fromkeys(targets, 0.0)
    seen: set[str] = set()
    with tempfile.TemporaryDirectory() as place:
        make_seeds(Path(place))
        with (
            Path(os.devnull).open("w") as quiet,
            contextlib.redirect_stdout(quiet),
            contextlib.redirect_stderr(quiet),
        ):
            for target in targets:  # what it imports, once: the children begin with it
                run_case(target, case(target, 0), Path(place))
        began = time.monotonic()
        while cases is not None or time.monotonic() - began < seconds:
            for target in targets:
                first = sum(table[target].values())
                count = max(5, min(500, int(TURN_S * first / spent_s[target]))) if first else FIRST_BATCH
                count = count if cases is None else min(count, cases - first)
                started = time.monotonic()
                for outcome, number, what in run_batch(target, first, count, Path(place)):
                    table[target][outcome] += 1
                    if outcome in OUTCOMES[2:]:
                        where = f"{target} {outcome} " + "".join(what.strip().splitlines()[-3:])[:300]
                        if where not in seen:
                            seen.add(where)
                            print(f"{target}:{number}: {outcome}\n{what[-1500:]}", flush=True)
                            if out is not None:
                                kept = out / "findings" / folder_of(target)
                                kept.mkdir(parents=True, exist_ok=True)
                                (kept / str(number)).write_bytes(case(target, number))
                spent_s[target] += time.monotonic() - started
            if out is not None:
                write_table(table, out / "fuzz.csv")
            if cases is not None and all(sum(counts.values()) >= cases for counts in table.values()):
                break
    return table


def write_table(table: dict[str, Counter[str]], path: Path) -> None:
    """Rows of outcomes, and a last one of all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    every = {**table, "all": sum(table.values(), Counter[str]())}
    none = dict.fromkeys(OUTCOMES, 0)
    rows = [{"target": t, "cases": sum(counts.values()), **none, **counts} for t, counts in every.items()]
    write_rows(path, ["target", "cases", *OUTCOMES], rows)


def main() -> int:
    """Exit status 1 where there is a finding."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=float(os.environ.get("MINUTES") or 5))
    parser.add_argument("--cases", type=int, help="of each target, instead of a time")
    parser.add_argument("--target", action="append", choices=list(TARGETS))
    parser.add_argument("--only", help="TARGET:NUMBER: this case, in this process")
    parser.add_argument("--out", type=Path, default=Path("runs") / "fuzz")
    given = parser.parse_args()
    if given.only:
        target, _, number = given.only.rpartition(":")
        with tempfile.TemporaryDirectory() as place, contextlib.suppress(KeyboardInterrupt):
            make_seeds(Path(place))
            print(*run_case(target, case(target, int(number)), Path(place)), sep="\n")
        return 0
    out = given.out.absolute()  # cases change the working directory
    table = fuzz(given.target or list(TARGETS), 60 * given.minutes, given.cases, out)
    print((out / "fuzz.csv").read_text())
    return int(any(counts[o] for counts in table.values() for o in OUTCOMES[2:]))


if __name__ == "__main__":
    raise SystemExit(main())
