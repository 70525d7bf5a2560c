"""The null device with a GPU on a simulated clock.

- Two clocks, in integer nanoseconds. The CPU's goes on with every call by a fixed time; by waits to when they
  end; and by `spend`, for the work that the program would do. The GPU's goes on with what it executes, by a
  `CostModel`.
- Calls gather in the queue. They are submitted by a signal, a wait, a read or the end of a frame, or when
  `batch` of them have gathered; the GPU sees them `submission_latency` later and executes them in order.
- The GPU is let run, up to the CPU's present time, whenever the CPU could see a difference. A command's
  effects appear when it starts, which for fences and queries is when all before it has ended.
- A place in the queue has its call site, as in a `CommandStream`, so that hazards (`hazards`) name lines.
"""

from __future__ import annotations

import math
import sys
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.backends.null.activity import Activity, ActivityLog, ActivityTimeline
from rhi.backends.null.backend import QUEUED_BYTES, NullBackend, Statistics
from rhi.backends.null.work import WorkMeter
from rhi.backends.null.cost import CostModel, Work
from rhi.descriptors import (
    BufferDescriptor,
    Id,
    PassDescriptor,
    ProgramDescriptor,
    QueryKind,
    Region,
    SamplerDescriptor,
    TextureDescriptor,
    VertexArrayDescriptor,
)
from rhi.errors import find_user_frame
from rhi.ops import WIDTHS, Op
from rhi.recorder import _get_frame, _nowhere

__rhi_internal__ = True
