"""The rules of traces."""

from __future__ import annotations

from typing import Final

from rhi.errors import Rule

__rhi_internal__ = True

TRACE_FILE: Final = Rule("trace-file", "the file is not a whole trace", "save it again: it may have been cut off")
TRACE_VERSION: Final = Rule(
    "trace-version", "the trace is of a version that this package doesn't read", "update the package"
)
TRACE_MEMBER: Final = Rule("trace-member", "the trace holds a file that traces don't have")
TRACE_SIZE: Final = Rule(
    "trace-size", "the trace is larger than allowed", "if you trust it, give load a larger max_bytes"
)
TRACE_COMMAND: Final = Rule("trace-command", "a command of the trace is not one of the contract's")
TRACE_ARRAY: Final = Rule("trace-array", "an array of the trace does not fit its command")
TRACE_COUNT: Final = Rule("trace-count", "the trace doesn't have as many commands as it says")
TRACE_REFERENCE: Final = Rule(
    "trace-reference", "a command of the trace can't be issued where it stands"
)
TRACE_INCOMPLETE: Final = Rule(
    "trace-incomplete",
    "the stream doesn't have all commands since the device was made",
    "don't clear or pause the recording before it is saved",
)
TRACE_CAPABILITY: Final = Rule(
    "trace-capability", "the device can't do what the trace does", "replay it on another backend"
)
TRACE_SOURCE: Final = Rule(
    "trace-source", "the trace has no source of this program in the backend's language"
)
TRACE_PREDICATE: Final = Rule(
    "trace-predicate",
    "the predicate can't be used to reduce the trace",
    "give a function of a trace that is true for it",
)
