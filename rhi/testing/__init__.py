"""Assertions on commands, for tests that need no GPU.

    expect(device.stream).draws(program="Shadow").within("sun").exactly(1)

- `expect` filters a stream by conditions and then checks how many commands are left (`expectation`).
- `count_work` compares the work that a block of code requested with the work that was issued after state
  caching (`work`).
- `EffectPattern` declares what belongs to an effect; `assert_free` asserts that a stream has nothing of it,
  and `assert_same` that two streams are the same (`footprints`).
- `assert_stream_matches` compares a whole stream with a file, which a flag of pytest updates (`stream_files`).
- `binding_data` returns the numbers in a uniform or storage binding at a command (`binding_data`).
- `why_bound` says why a command binds, and `needless_bindings` lists those that bind the same again.
- `explain_invisible_draw` lists possible reasons why a draw isn't visible (`nothing`).
- `portability` checks a frame against the capabilities of other devices.
- The pytest plugin, with fixtures and the option `--rhi-backend`, is the package `rhi_pytest`.
"""

from rhi.commands.buffer_bytes import UnknownDataError
from rhi.testing.buffer_tracking import binding_data
from rhi.testing.effect_patterns import EffectPattern, assert_free, assert_same
from rhi.testing.expectation import Expectation, expect, frames
from rhi.testing.invisible_draws import Cause, explain_invisible_draw
from rhi.testing.rebinding import BindReason, BoundBecause, needless_bindings, why_bound
from rhi.testing.stream_files import assert_stream_matches
from rhi.testing.work import CallCounts, Work, count_work

__all__ = [
    "BindReason",
    "BoundBecause",
    "CallCounts",
    "Cause",
    "EffectPattern",
    "Expectation",
    "UnknownDataError",
    "Work",
    "assert_free",
    "assert_same",
    "assert_stream_matches",
    "binding_data",
    "count_work",
    "expect",
    "explain_invisible_draw",
    "frames",
    "needless_bindings",
    "why_bound",
]
