"""`save` and `load`: a command stream as a file; `python -m rhi docs traces` describes the format.

- A loaded trace has an ordinary stream. Loaded commands have everything that recorded ones have, call sites
  included.
- Loading validates everything, because backends don't: `codec` the types, `archive` names and sizes,
  `validation` that each command is valid where it stands.
"""

from __future__ import annotations

import hashlib
import json
from bisect import bisect_left
from collections import deque
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from types import CodeType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.commands.ops import Op
from rhi.commands.stream import Command, CommandStream, Failure, Refusal, call_site_at
from rhi.contract.descriptors import ProgramDescriptor, Region, Stage, TextureDescriptor
from rhi.device.device import Device
from rhi.errors import refuse
from rhi.errors.call_sites import CallSite
from rhi.trace import rules
from rhi.trace.archive import COMMANDS, HEADER, MAX_BYTES, ArchiveReader, ArchiveWriter, source_name
from rhi.trace.codec import NOT_SAVED, MismatchError, Sources, argument_types, decode, encode, sources_of
from rhi.trace.validation import SequenceValidator

FORMAT: Final = "rhi-trace"
VERSION: Final = 2
"""Version of the format. 2 added lines for refused calls."""
_OPS: Final = {op.method: op for op in Op}


@dataclass(frozen=True, eq=False)
class Trace:
    """The complete stream of a device since its creation.

    Attributes:
        stream: the commands, as an ordinary stream.
        backend: name of the backend on which the trace was recorded, "" if it is unknown.
        file: the name of the file that it was loaded from, "" if it is a recording of this process.
        trusted: whether devices may run its shaders: those of a file are text that anybody may have written.
    """

    stream: CommandStream
    backend: str = ""
    file: str = ""
    trusted: bool = True

    def __len__(self) -> int:
        return len(self.stream)

    @property
    def refusals(self) -> tuple[Refusal, ...]:
        """The calls that were refused while the trace was recorded."""
        return self.stream.refusals

    def select(self, indices: list[int], *, refusals: bool = True) -> Trace:
        """Return a trace of some of the commands, in order. It includes the refused calls between them,
        unless excluded."""
        selected = CommandStream()
        if refusals:
            for refusal in self.refusals:
                selected.add_refusal(replace(refusal, index=bisect_left(indices, refusal.index)))
        for index in indices:
            op, values, code, lasti = self.stream.entry(index)
            failure = self.stream.failures.get(index)
            selected.data.extend((op, *values, code, lasti))
            if failure is not None:
                selected.failures[len(selected) - 1] = failure
        return replace(self, stream=selected)


def as_trace(source: Trace | Device | CommandStream) -> Trace:
    """Return a recorded stream as a trace.

    Raises:
        ValidationError: `trace-incomplete` if the stream was cleared or its recording paused.
    """
    if isinstance(source, Trace):
        return source
    stream = source.stream if isinstance(source, Device) else source
    if not stream.is_complete:
        refuse(
            rules.TRACE_INCOMPLETE,
            "rhi.trace",
            f"a stream of {len(stream)} commands that was cleared or paused",
        )
    return Trace(stream, source.backend_name if isinstance(source, Device) else "")


# -- writing -------------------------------------------------------------------------------------------------


def save(source: Trace | Device | CommandStream, path: str | PathLike[str]) -> None:
    """Write a recorded stream to a file. An existing file is replaced only when the new one is complete.

    Raises:
        ValidationError: `trace-incomplete` if the stream was cleared or its recording paused.

    Examples:
        >>> save(device, "frame.zip")
        >>> len(load("frame.zip").stream) == len(device.stream)
        True
    """
    trace = as_trace(source)
    with ArchiveWriter(Path(path)) as writer:
        numbers: dict[
            bytes, int
        ] = {}  # arrays by digest, so that data that is written each frame is stored once
        sites: dict[tuple[str, int, str], int] = {}
        lines: list[str] = []
        refusals = deque(trace.refusals)
        for command in trace.stream:
            while refusals and refusals[0].index <= command.index:
                lines.append(_to_json(_describe_refusal(refusals.popleft(), sites)))
            arguments = command.arguments
            if command.op is Op.CREATE_PROGRAM:
                for (language, stage), text in sources_of(arguments["descriptor"]).items():
                    writer.write(source_name(arguments["program"], stage.value, language), text)
            plain = {
                name: _write_array(writer, numbers, command, value)
                if isinstance(value, bytes)
                else encode(value)
                for name, value in arguments.items()
            }
            lines.append(_to_json(_describe(command, plain, sites)))
        lines.extend(_to_json(_describe_refusal(refusal, sites)) for refusal in refusals)
        writer.write(COMMANDS, "".join(f"{line}\n" for line in lines))
        header = {
            "format": FORMAT,
            "version": VERSION,
            "backend": trace.backend,
            "commands": len(trace),
            "refusals": len(trace.refusals),
            "sites": [list(site) for site in sites],
        }
        writer.write(HEADER, json.dumps(header))


def _describe(
    command: Command, arguments: dict[str, Any], sites: dict[tuple[str, int, str], int]
) -> dict[str, Any]:
    line: dict[str, Any] = {"op": command.op.method, "arguments": arguments}
    _add_site(line, command.site, sites)
    if command.failure is not None:
        line["failure"] = {"error": command.failure.error, "message": command.failure.message}
    return line


def _describe_refusal(refusal: Refusal, sites: dict[tuple[str, int, str], int]) -> dict[str, Any]:
    line: dict[str, Any] = {
        "refused": refusal.error,
        "call": refusal.call,
        "given": refusal.given,
        "allowed": refusal.allowed,
        "labels": list(refusal.labels),
    }
    _add_site(line, refusal.site, sites)
    return line


def _add_site(line: dict[str, Any], site: CallSite | None, sites: dict[tuple[str, int, str], int]) -> None:
    if site is not None:
        line["site"] = sites.setdefault((site.file, site.line, site.function), len(sites))


def _to_json(line: dict[str, Any]) -> str:
    return json.dumps(line, separators=(",", ":"))


def _write_array(writer: ArchiveWriter, numbers: dict[bytes, int], command: Command, data: bytes) -> int:
    array: NDArray[Any] = np.frombuffer(data, np.uint8)
    if command.op is Op.WRITE_TEXTURE:
        texture, region = command.resource(command["texture"]), command["region"]
        plain = isinstance(texture, TextureDescriptor) and texture.compressed is None
        if isinstance(texture, TextureDescriptor) and plain and len(data) == _texel_bytes(texture, region):
            array = array.view(texture.format.dtype).reshape(_texel_shape(texture, region))
    digest = hashlib.sha256(f"{array.dtype.str}{array.shape}".encode() + data).digest()
    if digest not in numbers:
        numbers[digest] = len(numbers)
        writer.write_array(numbers[digest], array)
    return numbers[digest]


def _texel_shape(texture: TextureDescriptor, region: Region) -> tuple[int, int, int, int]:
    return region.layers, region.height, region.width, texture.format.components


def _texel_bytes(texture: TextureDescriptor, region: Region) -> int:
    return region.layers * region.height * region.width * texture.format.transfer_bytes


# -- reading -------------------------------------------------------------------------------------------------


def load(path: str | PathLike[str], *, max_bytes: int = MAX_BYTES, trusted: bool = False) -> Trace:
    """Read a trace, which may come from anybody. Nothing of it is executed or imported.

    Args:
        max_bytes: the limit of its unpacked size.
        trusted: let devices compile and run its shaders. Those are text in the language of a driver, which
            can read and write this process's memory on OpenCL; so only for files of authors whom you know.
            Everything else is checked all the same.

    Raises:
        ValidationError: the file is damaged, too large, or not a trace (rules `trace-…`).
        OSError: the file can't be opened.

    Examples:
        >>> save(device, "frame.zip")
        >>> trace = load("frame.zip")
        >>> draws = trace.stream.draws()
    """
    with ArchiveReader(Path(path), max_bytes) as reader:
        return _Loader(reader, Path(path).name, trusted).load()


class _Loader:
    """Reads one trace file."""

    def __init__(self, reader: ArchiveReader, file: str, trusted: bool) -> None:
        self.reader = reader
        self.file = file
        self.trusted = trusted
        self.stream = CommandStream()
        self.validator = SequenceValidator()
        self.arrays: dict[int, NDArray[Any]] = {}
        self.sites: list[CodeType] = []

    def load(self) -> Trace:
        header = self._read_header()
        lines = self.reader.read_text(COMMANDS).splitlines()
        self.sites = [_make_code(*site) for site in header["sites"]]
        for number, line in enumerate(lines, 1):
            self._read_line(number, line)
        counts = {"commands": len(self.stream), "refusals": len(self.stream.refusals)}
        for name, count in counts.items():
            if count != header[name]:
                self.reader.refuse(
                    rules.TRACE_COUNT, f"{count} {name}", f"{header[name]}, as its header says"
                )
        return Trace(self.stream, header["backend"], self.file, self.trusted)

    def _read_header(self) -> dict[str, Any]:
        header = self._parse(HEADER, self.reader.read_text(HEADER))
        if header.get("format") != FORMAT:
            self.reader.refuse(rules.TRACE_FILE, f"format {header.get('format')!r}", FORMAT)
        version = header.get("version")
        if type(version) is not int or not 1 <= version <= VERSION:
            self.reader.refuse(rules.TRACE_VERSION, f"version {version!r}", f"1 to {VERSION}")
        try:
            sites = tuple[tuple[str, int, str], ...]
            types: dict[str, Any] = {"backend": str, "commands": int, "refusals": int, "sites": sites}
            header.setdefault("refusals", 0)  # version 1 had none
            return {name: decode(type, header.get(name), name) for name, type in types.items()}
        except MismatchError as error:
            self.reader.refuse(rules.TRACE_FILE, f"{HEADER}: {error}", "what rhi.trace.save writes")

    def _parse(self, where: str, text: str) -> dict[str, Any]:
        try:
            value = json.loads(text)
        except (ValueError, RecursionError) as error:
            self.reader.refuse(rules.TRACE_FILE, f"{where}: {error}", "a JSON object")
        if not isinstance(value, dict):
            self.reader.refuse(rules.TRACE_FILE, f"{where}: a {type(value).__name__}", "a JSON object")
        return value

    def _read_line(self, number: int, text: str) -> None:
        where = f"line {number} of {COMMANDS}"
        line = self._parse(where, text)
        if "refused" in line:
            self._read_refusal(where, line)
        else:
            self._read_command(where, line)

    def _read_refusal(self, where: str, line: dict[str, Any]) -> None:
        code = None
        try:
            if "site" in line:
                code = self._read_site(line.pop("site"))
            types: dict[str, Any] = dict.fromkeys(("refused", "call", "given", "allowed"), str)
            types["labels"] = tuple[str, ...]
            if line.keys() != types.keys():
                raise MismatchError(f"a refused call of {', '.join(line)}")
            error, call, given, allowed, labels = (
                decode(type, line[name], name) for name, type in types.items()
            )
        except MismatchError as mismatch:
            self.reader.refuse(rules.TRACE_COMMAND, f"{where}: {mismatch}", "what rhi.trace.save writes")
        site = call_site_at(code, 0)
        self.stream.add_refusal(Refusal(len(self.stream), error, call, given, allowed, site, labels))

    def _read_site(self, entry: object) -> CodeType:
        site: int = decode(int, entry, "site")
        if not 0 <= site < len(self.sites):
            raise MismatchError(f"site {site} of {len(self.sites)}")
        return self.sites[site]

    def _read_command(self, where: str, line: dict[str, Any]) -> None:
        try:
            op = _OPS.get(line.get("op", ""))
            if op is None or not isinstance(line.get("arguments"), dict):
                raise MismatchError(f"op {line.get('op')!r}")
            if line.keys() - {"op", "arguments", "site", "failure"}:
                raise MismatchError(
                    f"unknown: {', '.join(line.keys() - {'op', 'arguments', 'site', 'failure'})}"
                )
            code = None
            if "site" in line:
                code = self._read_site(line["site"])
            failure = decode(Failure, line["failure"], "failure") if "failure" in line else None
            arguments = line["arguments"]
            types = argument_types(op)
            if arguments.keys() != types.keys():
                raise MismatchError(f"{op.method}({', '.join(arguments)}) instead of ({', '.join(types)})")
            values: list[Any] = [
                self._read_array(where, arguments[name])
                if type is BytesLike
                else decode(type, arguments[name], f"{op.method}.{name}")
                for name, type in types.items()
            ]
        except (MismatchError, TypeError) as error:
            self.reader.refuse(
                rules.TRACE_COMMAND, f"{where}: {error}", "a method of rhi.Backend and its arguments"
            )
        if op is Op.CREATE_PROGRAM:
            self._read_sources(values[0], values[1])
        values = self._check(where, op, values, failure)
        self.stream.data.extend((int(op), *values, code, 0))
        if failure is not None:
            self.stream.failures[len(self.stream) - 1] = failure

    def _read_array(self, where: str, number: object) -> NDArray[Any]:
        if type(number) is not int:
            self.reader.refuse(rules.TRACE_ARRAY, f"{where}: array {number!r}", "the number of an array")
        if number not in self.arrays:
            self.arrays[number] = self.reader.read_array(number)
        return self.arrays[number]

    def _read_sources(self, program: int, descriptor: ProgramDescriptor) -> None:
        sources: Sources = descriptor.emit.__self__  # type: ignore[attr-defined]
        sources.trusted = self.trusted
        for stage, language in self.reader.list_sources(program):
            if Stage(stage) in descriptor.stages and language not in NOT_SAVED:
                text = self.reader.read_text(source_name(program, stage, language))
                sources.texts[language, Stage(stage)] = text

    def _check(self, where: str, op: Op, values: list[Any], failure: Failure | None) -> list[Any]:
        """Return the arguments in the form that backends receive: memory as bytes."""
        if op in (Op.WRITE_BUFFER, Op.WRITE_TEXTURE):
            array = values[-1]
            plain = array.dtype == np.uint8 and array.ndim == 1
            if op is Op.WRITE_TEXTURE and not plain:
                texture = self.validator.context.resources.get(values[0])
                plain = (
                    isinstance(texture, TextureDescriptor)
                    and array.dtype == texture.format.dtype
                    and array.shape == _texel_shape(texture, values[2])
                )
            if not plain:
                self.reader.refuse(
                    rules.TRACE_ARRAY,
                    f"{where}: {array.dtype} of shape {array.shape}",
                    "uint8 in one dimension, or the texels that the region has",
                )
            values = [*values[:-1], array.tobytes()]
        self.validator.check(op, values, failure is not None, where, self.reader)
        return values


def _make_code(file: str, line: int, function: str) -> CodeType:
    """Return a code object that stands for a call site, since a call site is a code object and an offset."""
    return _nowhere.__code__.replace(
        co_filename=file, co_firstlineno=max(0, min(line, 1 << 30)), co_name=function, co_qualname=function
    )


def _nowhere() -> None: ...
