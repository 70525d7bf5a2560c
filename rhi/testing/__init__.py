"""Assertions on commands, for tests that need no GPU.

    expect(device.stream).draws(program="Shadow").within("sun").exactly(1)

- `expect` filters a stream by conditions and then checks how many commands are left (`expectation`).
- `watch` compares the work that a block of code requested with the work that was issued after state caching (`work`).
- `Footprint` declares what belongs to an effect; `assert_free` asserts that a stream has nothing of it, and
  `assert_same` that two streams are the same (`footprints`).
- `contents` returns the numbers in a uniform or storage binding at a command (`contents`).
- `why_nothing` lists possible reasons why a draw isn't visible (`nothing`).
- `portability` checks a frame against the capabilities of other devices.
- `plugin` is the pytest plugin: fixtures and the option `--rhi-backend`.
"""

from rhi.testing.contents import UnknownContentsError, contents
from rhi.testing.expectation import Expectation, expect, frames
from rhi.testing.footprints import Footprint, assert_free, assert_same
from rhi.testing.nothing import Cause, why_nothing
from rhi.testing.work import Calls, Work, watch

__all__ = [
    "Calls", "Cause", "Expectation", "Footprint", "UnknownContentsError", "Work", "assert_free", "assert_same",
    "contents", "expect", "frames", "watch", "why_nothing",
]  # fmt: skip
