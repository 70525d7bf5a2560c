"""Traces: the commands of a device as a file that any backend can replay.

    save(device, "frame.zip")                                    # recorded on the null device, for example
    image = replay(load("frame.zip"), on=gl_device).image

- A trace is the recorder's stream since the creation of the device (`file`; `python -m rhi docs traces`
  describes the format).
- `replay` executes it on any device, `diff` compares two traces label by label, `reduce` shrinks one that
  shows a fault.
"""

from rhi.errors.exports import list_public as _list_public
from rhi.trace.diff import Difference as Difference
from rhi.trace.diff import Differences as Differences
from rhi.trace.diff import diff as diff
from rhi.trace.file import Trace as Trace
from rhi.trace.file import load as load
from rhi.trace.file import save as save
from rhi.trace.reduce import reduce as reduce
from rhi.trace.reduce import write_test as write_test
from rhi.trace.replay import Replay as Replay
from rhi.trace.replay import replay as replay

__all__ = _list_public(globals())
