"""The two containers of glTF 2.0: `.gltf`, JSON that names its buffers, and `.glb`, JSON and a buffer in one
file.

A `GltfFile` is opened by its first bytes, not by its extension. Buffers are read when they are first used,
and only then checked, so that what nothing refers to isn't read.
"""

from __future__ import annotations

import base64
import json
import re
from codecs import BOM_UTF8
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, NoReturn
from urllib.parse import unquote, urlsplit

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.content.gltf.document import JsonObject
from renderer.content.gltf.extras import migrate_document
from renderer.content.limits import Budget
from rhi.errors import RhiError, refuse

EXTENSIONS: Final = {
    "EXT_texture_webp": "texture",
    "KHR_lights_punctual": "node",
    "KHR_materials_anisotropy": "material",
    "KHR_materials_emissive_strength": "material",
    "KHR_materials_unlit": "material",
    "KHR_mesh_quantization": "mesh",
    "KHR_texture_transform": "texture",
    "MOZ_lightmap": "material",
}
"""The extensions that are read, and the kind of object of the file that uses each."""
LISTED_WHERE_USED: Final = ("KHR_materials_", "KHR_texture_", "EXT_texture_")
"""The beginnings of extensions that are omitted only where something uses them, not because the file lists
them."""

_USERS: Final = {
    "texture": ("materials", "textures"),
    "material": ("materials",),
    "node": ("nodes", "extensions.KHR_lights_punctual", ""),
    "mesh": ("meshes", ""),
}
"""Where the kinds of objects stand in a document; the empty text is the document itself."""

EXPORT_TIP: Final = "export it without compression and other extensions, with textures as PNG or JPEG"
"""The tip for files that need extensions which aren't read."""

_OPAQUE: Final = ("extensions", "extras")  # whose fields aren't glTF's
MAGIC: Final = b"glTF"
JSON_CHUNK: Final = 0x4E4F534A
BINARY_CHUNK: Final = 0x004E4942

ByteArray = NDArray[np.uint8]


class GltfFile:
    """The JSON of a glTF file, and its buffers.

    Attributes:
        path: the path as the user gave it.
        budget: what the file may still ask for.
        root: the document.
        files: those that were read or looked for so far, this one first.
    """

    def __init__(self, path: str, budget: Budget | None = None) -> None:
        self.path = path
        self.budget = budget or Budget(path)
        self.files = [Path(path)]
        self._folder = Path(path).parent
        self._buffers: dict[int, ByteArray] = {}
        self._binary: ByteArray | None = None
        content = _read_bytes(path, self.budget)
        text = content.tobytes() if content[:4].tobytes() != MAGIC else self._split(content)
        if not text.removeprefix(BOM_UTF8).lstrip().startswith(b"{"):
            _refuse(path, f"it begins with {text[:16]!r}", "a .glb, or a JSON object in UTF-8")
        try:
            parsed = json.loads(text.decode("utf-8-sig").rstrip("\0"))  # some exporters pad with zeros
        except RecursionError:
            _refuse(path, "its JSON: too deep")
        except ValueError as error:  # of its encoding, its syntax, or a number
            _refuse(path, f"its JSON: {error}")
        migrate_document(parsed, f"load_model({path!r})")
        self.root = JsonObject(path, "", parsed)
        self._check_version()
        self.views = self.root.children("bufferViews")
        self._declared = self.root.children("buffers")

    def view(self, number: int) -> ByteArray:
        """Return the bytes of a buffer view."""
        fields = self.views[number]
        buffer = self.buffer(fields.index("buffer", len(self._declared), required=True))
        offset = fields.whole("byteOffset", 0)
        length = fields.whole("byteLength", low=1)
        if offset + length > len(buffer):
            fields.refuse("", f"bytes {offset:,} to {offset + length:,}", f"0 to {len(buffer):,}")
        return buffer[offset : offset + length]

    def buffer(self, number: int) -> ByteArray:
        """Return the bytes of a buffer, as many as it declares."""
        if number not in self._buffers:
            fields = self._declared[number]
            length = fields.whole("byteLength", low=1)
            if "uri" in fields:
                data = self.read(fields)
            elif number == 0 and self._binary is not None:
                data = self._binary
            else:
                others = ", ".join(fields.child("extensions").values)  # such as EXT_meshopt_compression
                problem = f"missing, with {others}" if others else "missing"
                fields.refuse(
                    "uri", problem, "the buffer's file, or data:…;base64,…", EXPORT_TIP if others else ""
                )
            if len(data) < length:
                fields.refuse("byteLength", f"{length:,}", f"at most {len(data):,}, the length of the data")
            self._buffers[number] = data[:length]
        return self._buffers[number]

    def read(self, fields: JsonObject) -> ByteArray:
        """Return the bytes that the field `uri` names: a file beside this one, or data in the field
        itself."""
        uri = fields.text("uri")
        if uri.startswith("data:"):
            header, _, data = uri.partition(",")
            if not header.endswith(";base64"):
                fields.refuse("uri", header, "data:…;base64,…")
            try:
                return np.frombuffer(base64.b64decode(data, validate=True), np.uint8)
            except ValueError as error:
                fields.refuse("uri", f"{error}: {header}", "base64")
        file = self.locate(uri)
        if file is None:
            fields.refuse("uri", uri, "the name of a file here, file:///…, or data:…;base64,…")
        try:
            file = self.budget.find(file)
            is_allowed = self.budget.allows(file)
            self.files.append(file)  # also if it is missing: it may be saved later
            content = self.budget.read(file) if is_allowed else b""
        except RhiError:
            raise
        except (OSError, ValueError) as error:  # also a name that no system has, such as one with a zero
            reason = getattr(error, "strerror", None) or str(error)
            fields.refuse("uri", f"{uri}: {reason}", f"a file in {self._folder.resolve()}")
        if not is_allowed:
            allowed = (
                f"a file in {self._folder.resolve()}, unless ModelLimits(outside=True) or {self.path}:outside"
            )
            fields.refuse("uri", uri, allowed)
        return np.frombuffer(content, np.uint8)

    def locate(self, uri: str) -> Path | None:
        """Return the file that `uri` names, relative to this one or by `file:`, or None if it isn't a local
        one."""
        try:
            parts = urlsplit(uri)
        except ValueError:
            return None
        if parts.scheme == "file" and parts.netloc.lower() in ("", "localhost"):
            return self._folder / unquote(parts.path)
        return self._folder / unquote(uri) if not parts.scheme else None

    def _split(self, content: ByteArray) -> bytes:
        """Split a `.glb` into its chunks; return the JSON and keep the buffer."""
        header = content[:20].view("<u4") if len(content) >= 20 else None
        if header is None:
            _refuse(self.path, f"{len(content)} bytes are too few for a .glb")
        if header[1] != 2:
            _refuse(self.path, f"version {header[1]} of .glb", "2")
        if header[2] > len(content):
            _refuse(self.path, f"{len(content):,} of {header[2]:,} bytes: the file was cut off")
        chunks: list[tuple[int, ByteArray]] = []
        at = 12
        while at + 8 <= int(header[2]):
            length, kind = (int(value) for value in np.frombuffer(content[at : at + 8].tobytes(), "<u4"))
            if at + 8 + length > len(content):
                allowed = f"{len(content) - at - 8:,} or less, padded to 4 bytes"
                _refuse(self.path, f"a chunk of {length:,} bytes at byte {at:,}", allowed)
            chunks.append((kind, content[at + 8 : at + 8 + length]))
            at += 8 + length + -length % 4
        if not chunks or chunks[0][0] != JSON_CHUNK:
            _refuse(self.path, "its first chunk isn't JSON")
        self._binary = next((data for kind, data in chunks[1:2] if kind == BINARY_CHUNK), None)
        return chunks[0][1].tobytes()

    def _check_version(self) -> None:
        asset = self.root.child("asset")
        for field in ("version", "minVersion"):
            version = asset.text(field, None if field == "version" else "2.0")
            numbers = re.fullmatch(r"([0-9]{1,9})(?:\.([0-9]{1,9}))?", version)
            major, minor = (int(part or 0) for part in numbers.groups()) if numbers is not None else (0, 0)
            if field == "version" and major != 2:  # later minor versions only add to 2.0
                asset.refuse(field, version, "2.0, or another 2.x")
            if field == "minVersion" and (numbers is None or (major, minor) > (2, 0)):
                asset.refuse(field, version, "2.0 or lower")
        required = [name for name in self.names("extensionsRequired") if name not in EXTENSIONS]
        if required:
            self.root.refuse("extensionsRequired", ", ".join(required), ", ".join(EXTENSIONS), EXPORT_TIP)

    def names(self, field: str) -> list[str]:
        """Return a list of texts in the document."""
        listed = self.root.values.get(field, [])
        if not isinstance(listed, list) or not all(isinstance(name, str) for name in listed):
            self.root.refuse(field, listed, "a list of texts")
        return listed


def list_unread_extensions(root: JsonObject) -> Iterator[tuple[str, str]]:
    """Yield the name and the place of each use of an extension that isn't read, anywhere in a document."""
    waiting: list[tuple[str, Any]] = [("", root.values)]
    while waiting:
        where, value = waiting.pop()
        if isinstance(value, list):
            objects = [
                (f"{where}[{at}]", part) for at, part in enumerate(value) if isinstance(part, dict | list)
            ]
            waiting += reversed(objects)
            continue
        used = value.get("extensions")
        for name, fields in used.items() if isinstance(used, dict) else ():
            user = EXTENSIONS.get(name)
            if user is None or where.partition("[")[0] not in _USERS[user]:
                yield name, where
            elif isinstance(fields, dict | list):
                waiting.append((f"{where}.extensions.{name}".lstrip("."), fields))
        parts = [(key, part) for key, part in value.items() if isinstance(part, dict | list)]
        below = [(f"{where}.{key}".lstrip("."), part) for key, part in parts if key not in _OPAQUE]
        waiting += reversed(below)


def _read_bytes(path: str, budget: Budget) -> ByteArray:
    try:
        return np.frombuffer(budget.read(path), np.uint8)
    except RhiError:
        raise
    except (OSError, ValueError) as error:
        _refuse(path, getattr(error, "strerror", None) or str(error))


def _refuse(path: str, value: str, allowed: str = "") -> NoReturn:
    refuse(rules.UNREADABLE_MODEL, f"load_model({path!r})", f"{path}: {value}", allowed)
