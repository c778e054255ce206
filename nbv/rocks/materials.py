"""Materials of mesh files; those of OBJ and PLY files are read here, since trimesh reads the plain ones only."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image, UnidentifiedImageError

from nbv.safe_files import require
from nbv.types import Floats

# Attributes of vertices: linear colours (V, 3) and texture coordinates (V, 2).
COLOR, UV = "_gatetune_color", "_gatetune_uv"
MAX_MATERIALS = 10_000
# Options before map_Kd's file that do not change a colour's place.
_HARMLESS = re.compile(r"(-(blendu|blendv|cc|clamp|imfchan|texres|bm|boost)\s+\S+\s+)+", re.I)

Files = Callable[[str], bytes]


class UnusableMesh(Exception):
    """Why a mesh file is no rock: what reads on after "mesh file NAME"."""


@dataclass(frozen=True)
class Material:
    """One material."""

    label: str = ""  # of its picture, "" where it has none
    image: Image.Image | None = None
    color: tuple[float, ...] | None = None  # sRGB, where there is no picture
    wrap: tuple[str, ...] = ("repeat", "repeat")  # beyond 0 to 1, of u and v: repeat, mirror or clamp


def open_image(files: Files, name: str, notes: list[str]) -> Material:
    """The picture called ``name`` of the mesh's; a note where it cannot be opened."""
    try:
        return Material(name, Image.open(io.BytesIO(files(name))))
    except Exception as error:  # what Pillow raises depends on the file
        told = (
            "no picture" if isinstance(error, UnidentifiedImageError) else " ".join(str(error).split())[:100]
        )
        notes.append(f"not read: texture {name!r} ({told})")
        return Material()


def rewritten_obj(
    content: bytes, files: Files, notes: list[str]
) -> tuple[bytes, dict[str, bytes], dict[str, Material]]:
    """The OBJ file with materials called by number, an MTL file with those numbers, and the materials by number.

    Names of materials are taken in another letter case where there is just one; a file whose faces name none has the only
    one of its MTL. Colours of vertices go before those of materials, textures before both.
    """
    names = re.findall(rb"^[ \t]*usemtl[ \t]+(.*?)[ \t\r]*$", content, re.M)
    numbers = {name: str(i) for i, name in enumerate(dict.fromkeys([b"", *names]))}
    require(len(numbers) - 1, MAX_MATERIALS, "the number of materials that the OBJ file's faces name")
    lines = re.findall(rb"^[ \t]*mtllib[ \t]+(.*?)[ \t\r]*$", content, re.M)
    # Several on a line, or one whose name has spaces.
    libraries = [
        n for line in dict.fromkeys(map(_text, lines)) for n in re.findall(r".+?\.mtl(?=\s|$)|.+", line, re.I)
    ]
    libraries = [name.strip() for name in libraries]
    known: dict[str, dict[str, str]] = {}
    for name in libraries:
        try:
            known |= _read_mtl(files(name))
        except Exception as error:
            notes.append(f"not read: materials {name!r} ({' '.join(str(error).split())[:100]})")
    found = {}
    for called, number in numbers.items():
        same = _named(_text(called), bool(names), known, ", ".join(libraries), notes)
        if same is not None and (material := _mtl_material(same, files, notes)) != Material():
            found[number] = material
    textured = any(material.label for material in found.values())
    if not textured and re.search(rb"^v([ \t]+[^ \t\r\n]+){6}[ \t\r]*$", content, re.M):
        found = {}
        if re.search(rb"^v([ \t]+\S+){3}.*[ \t]([2-9]|\d\d+)(\.\d*)?(?=\s)", content, re.M):
            notes.append("colours of vertices go beyond 1: taken as parts of 255")
            content = re.sub(
                rb"^(v(?:[ \t]+\S+){3})[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)",
                lambda m: m[1] + b" %g %g %g" % tuple(float(m[i]) / 255 for i in (2, 3, 4)),
                content,
                flags=re.M,
            )
    drop = rb"^[ \t]*(mtllib[ \t].*)$" if textured else rb"^[ \t]*(mtllib[ \t].*|vt[ \t].*)$"
    content = re.sub(drop, b"", content, flags=re.M)
    content = re.sub(
        rb"^[ \t]*usemtl[ \t]+(.*?)[ \t\r]*$",
        lambda m: b"usemtl " + numbers[m[1]].encode(),
        content,
        flags=re.M,
    )
    mtl = "".join(f"newmtl {number}\nillum 1\n" for number in found)
    return b"mtllib plain.mtl\nusemtl 0\n" + content, {"plain.mtl": mtl.encode()}, found


def _named(
    name: str, named: bool, known: dict[str, dict[str, str]], library: str, notes: list[str]
) -> dict[str, str] | None:
    """The material of `known` that a face means which names ``name``, or none; ``named``: other faces do."""
    same = [n for n in known if n == name] or [n for n in known if n.casefold() == name.casefold()]
    if not name and not named and len(known) == 1:
        same = list(known)
        notes.append(f"no face names a material (usemtl): took {same[0]!r}, the only one in {library}")
    elif not name and not named and known:
        notes.append(f"not read: the {len(known)} materials in {library}; no face names one (usemtl)")
    elif name and known and len(same) != 1:
        notes.append(f"not read: material {name!r}, which is not in {library}")
    return known[same[0]] if len(same) == 1 else None


def _text(name: bytes) -> str:
    return name.decode("utf-8", "surrogateescape")


def _read_mtl(content: bytes) -> dict[str, dict[str, str]]:
    found: dict[str, dict[str, str]] = {}
    current: dict[str, str] = {}
    for line in content.splitlines():
        key, _, value = re.sub(r"\s+", " ", _text(line).strip(), count=1).partition(" ")
        if key.lower() == "newmtl":
            current = found.setdefault(value, {})
        elif key.lower() in ("kd", "map_kd"):
            current[key.lower()] = value
    return found


def _mtl_material(material: dict[str, str], files: Files, notes: list[str]) -> Material:
    if picture := _HARMLESS.sub("", material.get("map_kd", "")):
        if picture.startswith("-"):
            notes.append(f"not read: texture with options (map_Kd {picture[:60]})")
            return Material()
        return open_image(files, picture.strip('"'), notes)
    try:
        return Material(color=tuple(float(c) for c in material.get("kd", "").split()[:3])[:3] or None)
    except ValueError:
        return Material()


def ply_images(content: bytes) -> list[str]:
    """Names of the pictures that a PLY file's header names."""
    header = content[: content.find(b"end_header")]
    return [
        _text(n) for n in re.findall(rb"^comment[ \t]+TextureFile[ \t]+(.*?)[ \t\r]*$", header, re.M | re.I)
    ]


def ply_column(part: Any, element: str, name: str) -> np.ndarray | None:
    """One property, such as ``face`` ``texnumber``, of a mesh that trimesh read from a PLY file; None where there is none."""
    data = part.metadata.get("_ply_raw", {}).get(element, {}).get("data")
    names = data if isinstance(data, dict) else (getattr(getattr(data, "dtype", None), "names", None) or ())
    return np.asarray(data[name]).reshape(-1) if data is not None and name in names else None


def ply_colors(part: Any) -> tuple[bool, Floats | None]:
    """Whether faces have the colours, and (N, 3) sRGB values, whatever kind of number the PLY file has them in."""
    for element, count in (("vertex", len(part.vertices)), ("face", len(part.faces))):
        for prefix in ("", "diffuse_"):
            columns = [ply_column(part, element, f"{prefix}{c}") for c in ("red", "green", "blue")]
            if all(column is not None and len(column) == count for column in columns):
                colors = np.stack(columns, axis=1)  # type: ignore[arg-type]
                wide = colors.dtype == np.uint16 or colors.max(initial=0) > 255
                whole = colors.dtype.kind in "iu" or colors.max(initial=0) > 1
                return element == "face", np.clip(
                    colors / (65535.0 if wide else 255.0 if whole else 1.0), 0, 1
                )
    return False, None
