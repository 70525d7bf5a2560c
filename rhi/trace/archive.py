"""The zip archive of a trace: members with fixed names, read without trusting their author.

Nothing is unpacked to disk. Names, compression methods, sizes and array headers are validated before memory
of that size is allocated: `trace-file`, `trace-member`, `trace-size`, `trace-array`.
"""

from __future__ import annotations

import errno
import io
import math
import re
import zipfile
import zlib
from pathlib import Path
from tokenize import TokenError
from typing import Any, Final, NoReturn, Self

import numpy as np
from numpy.typing import NDArray

from rhi.errors import Rule, refuse
from rhi.trace.rules import TRACE_ARRAY, TRACE_FILE, TRACE_MEMBER, TRACE_SIZE

HEADER: Final = "trace.json"
COMMANDS: Final = "commands.jsonl"
MAX_BYTES: Final = 1 << 30
"""Default limit of the unpacked size of a trace, in bytes."""

_MEMBERS: Final = re.compile(
    r"trace\.json|commands\.jsonl|arrays/(0|[1-9]\d{0,8})\.npy"
    r"|programs/[1-9]\d{0,18}\.(vertex|fragment|compute)\.[a-z]{1,16}[0-9]{0,4}"
)
_PROGRAMS: Final = "programs/"
_METHODS: Final = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


def array_name(number: int) -> str:
    """Return the name of the member that contains an array."""
    return f"arrays/{number}.npy"


def source_name(program: int, stage: str, language: str) -> str:
    """Return the name of the member that contains the source of a stage."""
    return f"{_PROGRAMS}{program}.{stage}.{language}"


class ArchiveWriter:
    """Writes the members of a trace. The file gets its name when it is complete."""

    def __init__(self, path: Path) -> None:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "it is a folder; name a file in it", str(path))
        self._path = path
        self._part = path.with_name(path.name + ".part")
        self._zip = zipfile.ZipFile(self._part, "w", zipfile.ZIP_DEFLATED, compresslevel=1)

    def write(self, name: str, data: bytes | str) -> None:
        info = zipfile.ZipInfo(name)  # with a fixed date, so that equal traces give equal files
        self._zip.writestr(info, data, zipfile.ZIP_DEFLATED)

    def write_array(self, number: int, array: NDArray[Any]) -> None:
        file = io.BytesIO()
        np.lib.format.write_array(file, np.ascontiguousarray(array), allow_pickle=False)
        self.write(array_name(number), file.getvalue())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        try:
            self._zip.close()
            if kind is None:
                self._part.replace(self._path)
        finally:  # it is gone if it has its name
            self._part.unlink(missing_ok=True)


class ArchiveReader:
    """Reads the members of a file that may come from anybody."""

    def __init__(self, path: Path, max_bytes: int) -> None:
        self._path = path
        try:
            self._zip = zipfile.ZipFile(path)
        except (zipfile.BadZipFile, ValueError, NotImplementedError) as error:
            self.refuse(TRACE_FILE, str(error), "a zip")
        self._infos: dict[str, zipfile.ZipInfo] = {}
        self._sources: dict[int, list[tuple[str, str]]] = {}
        total = 0
        try:
            for info in self._zip.infolist():
                self._check_member(info)
                self._infos[info.filename] = info
                if info.filename.startswith(_PROGRAMS):
                    program, stage, language = info.filename.removeprefix(_PROGRAMS).split(".")
                    self._sources.setdefault(int(program), []).append((stage, language))
                total += info.file_size
            if total > max_bytes:
                self.refuse(TRACE_SIZE, f"{total:,} bytes unpacked", f"{max_bytes:,} bytes")
            for name in (HEADER, COMMANDS):
                if name not in self._infos:
                    self.refuse(TRACE_FILE, f"no {name}", "a zip that rhi.trace.save wrote")
        except BaseException:
            self._zip.close()
            raise

    def _check_member(self, info: zipfile.ZipInfo) -> None:
        name = info.filename
        if not _MEMBERS.fullmatch(name):
            self.refuse(
                TRACE_MEMBER, name, "trace.json, commands.jsonl, arrays/N.npy, programs/N.STAGE.LANGUAGE"
            )
        if name in self._infos:
            self.refuse(TRACE_MEMBER, f"{name} twice", "each once")
        if info.compress_type not in _METHODS:
            self.refuse(
                TRACE_FILE, f"{name}, compressed by method {info.compress_type}", "stored or deflated"
            )

    def refuse(self, rule: Rule, value: object, allowed: object = "") -> NoReturn:
        """Refuse the file for breaking a rule."""
        refuse(rule, f"rhi.trace.load({self._path.name!r})", value, allowed)

    def __contains__(self, name: str) -> bool:
        return name in self._infos

    def names(self) -> list[str]:
        return list(self._infos)

    def list_sources(self, program: int) -> list[tuple[str, str]]:
        """Return the stages and languages in which a program has a source."""
        return self._sources.get(program, [])

    def read(self, name: str) -> bytes:
        """Return the bytes of a member, after checking its size and checksum."""
        try:
            return self._zip.read(self._infos[name])
        except (
            zipfile.BadZipFile,
            zlib.error,
            EOFError,
            OSError,
            NotImplementedError,
            RuntimeError,
        ) as error:
            self.refuse(TRACE_FILE, f"{name}: {error or type(error).__name__}", "a whole file")

    def read_text(self, name: str) -> str:
        try:
            return self.read(name).decode()
        except UnicodeDecodeError as error:
            self.refuse(TRACE_FILE, f"{name}: {error}", "text in UTF-8")

    def read_array(self, number: int) -> NDArray[Any]:
        """Return a member as an array of plain numbers."""
        name = array_name(number)
        if name not in self._infos:
            self.refuse(TRACE_ARRAY, f"no {name}", "each array that a command names")
        file = io.BytesIO(self.read(name))
        try:
            version = np.lib.format.read_magic(file)
            read_header = {
                (1, 0): np.lib.format.read_array_header_1_0,
                (2, 0): np.lib.format.read_array_header_2_0,
            }[version]
            shape, fortran, dtype = read_header(file)
        except (
            ValueError,
            KeyError,
            SyntaxError,
            TypeError,
            RecursionError,
            MemoryError,
            TokenError,
        ) as error:
            self.refuse(
                TRACE_ARRAY, f"{name}: {str(error).splitlines()[:1] or type(error).__name__}", "a .npy of 1.0"
            )
        if dtype.kind not in "uif" or fortran or any(size < 0 for size in shape):
            self.refuse(TRACE_ARRAY, f"{name}: {dtype}, shape {shape}", "plain numbers in C order")
        data = file.read()
        if math.prod(shape) * dtype.itemsize != len(data):
            self.refuse(
                TRACE_ARRAY,
                f"{name}: shape {shape} of {dtype}, {len(data)} bytes",
                "as many bytes as it says",
            )
        return np.frombuffer(data, dtype).reshape(shape)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._zip.close()
