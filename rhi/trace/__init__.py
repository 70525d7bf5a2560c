"""Traces: the commands of a device as a file that any backend can replay.

    save(device, "frame.zip")                                    # recorded on the null device, for example
    image = replay(load("frame.zip"), on=gl_device).image

- A trace is the recorder's stream since the creation of the device (`file`; docs/traces.md describes the format).
- `replay` executes it on any device, `diff` compares two traces label by label, `reduce` shrinks one that shows a
  fault.
"""

from rhi.trace.diff import Difference, Differences, diff
from rhi.trace.file import Trace, load, save
from rhi.trace.reduce import reduce, write_test
from rhi.trace.replay import Replay, replay

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
