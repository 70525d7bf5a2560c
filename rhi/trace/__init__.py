"""Traces: what a device was told, as a file that any backend replays.

    save(device, "frame.zip")                                    # recorded on null, say
    image = replay(load("frame.zip"), on=gl_device).image

- A trace is the recorder's stream, from the making of the device on (`file`; docs/traces.md has the format).
- `replay` issues it on any device; `diff` aligns two of them by labels; `reduce` shrinks one that fails.
"""

from rhi.trace.diff import Difference, Differences, diff
from rhi.trace.file import Trace, load, save
from rhi.trace.reduce import reduce, write_test
from rhi.trace.replay import Replay, replay

__rhi_internal__ = True

__all__ = [
    "Difference",
    "Differences",
    "Replay",
    "Trace",
    "diff",
    "load",
    "reduce",
    "replay",
    "save",
    "write_test",
]
