"""The rules of traces."""

from __future__ import annotations

from typing import Final

from rhi.errors import Rule

TRACE_FILE: Final = Rule(
    "trace-file", "the file is not a complete trace", "save it again; it may be truncated"
)
TRACE_VERSION: Final = Rule(
    "trace-version", "this package doesn't support the version of the trace", "update the package"
)
TRACE_MEMBER: Final = Rule("trace-member", "the trace contains a file that doesn't belong to a trace")
TRACE_SIZE: Final = Rule(
    "trace-size", "the trace is larger than allowed", "if you trust it, call load with a larger max_bytes"
)
TRACE_COMMAND: Final = Rule("trace-command", "a command of the trace is not part of the contract")
TRACE_ARRAY: Final = Rule("trace-array", "an array of the trace doesn't match its command")
TRACE_COUNT: Final = Rule("trace-count", "the number of commands differs from the header of the trace")
TRACE_REFERENCE: Final = Rule("trace-reference", "a command of the trace is invalid where it stands")
TRACE_INCOMPLETE: Final = Rule(
    "trace-incomplete",
    "the stream doesn't contain all commands since the device was created",
    "don't clear or pause the recording before saving it",
)
TRACE_CAPABILITY: Final = Rule(
    "trace-capability", "the device lacks a capability that the trace needs", "replay it on another backend"
)
TRACE_SOURCE: Final = Rule(
    "trace-source", "the trace has no source of this program in the language of the backend"
)
TRACE_PREDICATE: Final = Rule(
    "trace-predicate",
    "the predicate can't be used to reduce the trace",
    "pass a function of a trace that is true for it",
)
TRACE_TRUST: Final = Rule(
    "trace-trust",
    "the shaders of a file run as they are, and the file isn't trusted",
    "if you know its author: load(…, trusted=True), or --trust; the null device replays it without its "
    "shaders",
)
TRACE_PAGE: Final = Rule(
    "trace-page",
    "a page can't replay this trace: a command depends on what a device must read back first",
    "draw lists of triangles instead of fans by indirect draws",
)
