"""A simulated backend driven directly, with round numbers for its times."""

from __future__ import annotations

from typing import Any

import numpy as np

from rhi.backends.null import CostModel, SimulatedBackend, Simulation
from rhi.contract import descriptors

PLAIN, STATIC, STREAM = 100, 200, 201

ROUND = CostModel(command=0, vertex=0, pixel=1, byte=0, state_change=0, invocation=0)
"""A cost model in which a draw takes a nanosecond for each counted sample, and everything else takes
nothing."""


def make_backend(cost: CostModel = ROUND, **times: Any) -> SimulatedBackend:
    """Create a backend on which a call takes 10 ns, a submission 100, and a wake-up 7, by default. A draw
    passes 1,000 samples per instance."""
    simulation = Simulation(cost, **({"call": 10, "submission_latency": 100, "wake_latency": 7} | times))
    backend = SimulatedBackend(simulation)
    backend.create_vertex_array(
        PLAIN, descriptors.VertexArrayDescriptor(1, (descriptors.VertexStream(STATIC, 0, 8, False, ()),))
    )
    backend.create_buffer(STATIC, descriptors.BufferDescriptor(256))
    backend.create_buffer(STREAM, descriptors.BufferDescriptor(256, descriptors.BufferUsage.STREAM))
    backend.count_samples(lambda draw: draw.instances * 1000)
    return backend


def draw(backend: SimulatedBackend, instances: int = 1) -> None:
    """Draw; it takes the GPU 1 µs per instance."""
    backend.draw(PLAIN, descriptors.Primitive.TRIANGLES, 0, 3, instances, 0, 0)


def begin_pass(backend: SimulatedBackend, label: str = "") -> None:
    backend.begin_pass(descriptors.PassDescriptor((64, 64), label=label))


def words(*values: int) -> bytes:
    return np.array(values, np.uint32).tobytes()
