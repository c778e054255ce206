"""A glTF file with what trimesh misreads put plainly: colours, coordinates and positions in whole numbers, textures that are moved."""

from __future__ import annotations

import base64
import copy
import json
import struct
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from nbv.types import Floats

_KINDS = {5120: "b", 5121: "B", 5122: "h", 5123: "H", 5125: "I", 5126: "f"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_FLOAT, _BYTE = 5126, 5121
MOVED = "KHR_texture_transform"


def plain_gltf(content: bytes, header: Mapping[str, Any], read: Callable[[str], bytes]) -> bytes:
    """``content`` with floats where trimesh needs them, or as it is; ``read`` gives the content of a file that a buffer names."""
    tree, file = copy.deepcopy(dict(header)), _Buffers(content, header, read)
    for primitive in (p for mesh in tree.get("meshes", ()) for p in mesh["primitives"]):
        attributes = primitive["attributes"]
        if "material" in primitive:
            _move(tree, attributes, header["materials"][primitive["material"]], file)
        for name in ("POSITION", "COLOR_0"):
            accessor = tree["accessors"][attributes[name]] if name in attributes else {}
            misread = accessor.get("normalized") and (
                name == "POSITION" or accessor["componentType"] != _BYTE
            )
            if misread or "sparse" in accessor:
                attributes[name] = file.put(tree, file.floats(attributes[name]))
    for material in tree.get("materials", ()):
        texture = material.get("pbrMetallicRoughness", {}).get("baseColorTexture", {})
        texture.pop("texCoord", None)
        texture.get("extensions", {}).pop(MOVED, None)
    return file.written(tree) if file.added else content


def _move(
    tree: dict[str, Any], attributes: dict[str, int], material: Mapping[str, Any], file: _Buffers
) -> None:
    """Make the coordinates of the colour's texture the first set, as floats, moved as the texture is."""
    texture = material.get("pbrMetallicRoughness", {}).get("baseColorTexture")
    if texture is None:
        return
    moved = texture.get("extensions", {}).get(MOVED, {})
    name = f"TEXCOORD_{int(moved.get('texCoord', texture.get('texCoord', 0)))}"
    if name not in attributes:
        attributes.pop("TEXCOORD_0", None)
        return
    accessor = tree["accessors"][attributes[name]]
    if (
        name == "TEXCOORD_0"
        and not moved
        and accessor["componentType"] == _FLOAT
        and "sparse" not in accessor
    ):
        return
    uv = file.floats(attributes[name]) * np.array(moved.get("scale", (1.0, 1.0)))
    cos, sin = np.cos(moved.get("rotation", 0.0)), np.sin(moved.get("rotation", 0.0))
    uv = uv @ np.array([[cos, -sin], [sin, cos]]) + np.array(moved.get("offset", (0.0, 0.0)))
    attributes["TEXCOORD_0"] = file.put(tree, uv)


class _Buffers:
    """Reads a file's accessors, and adds others."""

    def __init__(self, content: bytes, header: Mapping[str, Any], read: Callable[[str], bytes]) -> None:
        self.added = bytearray()
        self._header, self._read = header, read
        self._binary = content[:4] == b"glTF"
        at = 20 + int.from_bytes(content[12:16], "little")
        self._chunk = (
            content[at + 8 : at + 8 + int.from_bytes(content[at : at + 4], "little")] if self._binary else b""
        )

    def floats(self, index: int) -> Floats:
        """(N, K) numbers of an accessor, normalised where it says so."""
        accessor = self._header["accessors"][index]
        width, count = _WIDTHS[accessor["type"]], int(accessor["count"])
        rows = self._rows(accessor, accessor["componentType"], width, count)
        if sparse := accessor.get("sparse"):
            some = int(sparse["count"])
            which = self._rows(sparse["indices"], sparse["indices"]["componentType"], 1, some)[:, 0]
            rows = rows.copy()
            rows[which] = self._rows(sparse["values"], accessor["componentType"], width, some)
        values = rows.astype(float)
        if accessor.get("normalized") and rows.dtype.kind in "iu":
            values = np.maximum(values / np.iinfo(rows.dtype).max, -1.0)
        return values

    def _rows(self, where: Mapping[str, Any], kind: int, width: int, count: int) -> Any:
        item = np.dtype(_KINDS[kind]).newbyteorder("<")
        if "bufferView" not in where:
            return np.zeros((count, width), item)
        view = self._header["bufferViews"][where["bufferView"]]
        start = view.get("byteOffset", 0) + where.get("byteOffset", 0)
        step = view.get("byteStride") or item.itemsize * width
        data = np.frombuffer(self._buffer(view["buffer"]), np.uint8)[start:]
        if count and (count - 1) * step + item.itemsize * width > len(data):
            raise ValueError("an accessor goes beyond its buffer")
        rows = np.lib.stride_tricks.as_strided(data, (count, item.itemsize * width), (step, 1))
        return np.ascontiguousarray(rows).view(item).reshape(count, width)

    def _buffer(self, index: int) -> bytes:
        uri = self._header["buffers"][index].get("uri")
        if uri is None:
            return self._chunk
        return base64.b64decode(uri.partition(",")[2]) if uri.startswith("data:") else self._read(uri)

    def put(self, tree: dict[str, Any], values: Floats) -> int:
        """Index of a new accessor with these (N, K) floats."""
        data, into = values.astype("<f4").tobytes(), 0 if self._binary else len(self._header["buffers"])
        start = len(self.added) + (len(self._chunk) if self._binary else 0)
        tree["bufferViews"].append({"buffer": into, "byteOffset": start, "byteLength": len(data)})
        self.added += data
        accessor = {"bufferView": len(tree["bufferViews"]) - 1, "componentType": _FLOAT, "count": len(values)}
        tree["accessors"].append({**accessor, "type": f"VEC{values.shape[1]}"})
        return len(tree["accessors"]) - 1

    def written(self, tree: dict[str, Any]) -> bytes:
        """The file with what was added."""
        if not self._binary:
            uri = "data:application/octet-stream;base64," + base64.b64encode(self.added).decode()
            tree["buffers"].append({"byteLength": len(self.added), "uri": uri})
            return json.dumps(tree).encode()
        chunk = self._chunk + self.added
        tree["buffers"][0]["byteLength"] = len(chunk)
        text = json.dumps(tree).encode()
        text, chunk = text + b" " * (-len(text) % 4), chunk + b"\0" * (-len(chunk) % 4)
        head = struct.pack("<4sIIII", b"glTF", 2, 28 + len(text) + len(chunk), len(text), 0x4E4F534A)
        return head + text + struct.pack("<II", len(chunk), 0x004E4942) + chunk
