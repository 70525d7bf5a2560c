"""Assertions on commands, for tests that need no GPU.

    expect(device.stream).draws(program="Shadow").within("sun").exactly(1)

- `expect` narrows a stream condition by condition and then says how many commands are left (`expectation`).
- `watch` compares what a block of code asked for with what was issued after state caching (`work`).
- `contents` is what a uniform or storage binding holds at a command (`contents`).
- `why_nothing` lists what could keep a draw from showing (`nothing`).
- `plugin` is the pytest plugin: fixtures and the option `--rhi-backend`.
"""

from rhi.testing.contents import UnknownContentsError, contents
from rhi.testing.expectation import Expectation, expect, frames
from rhi.testing.nothing import Cause, why_nothing
from rhi.testing.work import Calls, Work, watch

__all__ = [
    "Calls", "Cause", "Expectation", "UnknownContentsError", "Work", "contents", "expect", "frames", "watch",
    "why_nothing",
]  # fmt: skip
