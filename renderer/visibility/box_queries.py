"""Occlusion queries of bounding boxes, in the middle of a technique's pass (thesis 6.2, steps 1 to 4).

What can be asked for is a node, which has one box or a few. All boxes are rows of one array, relative to the
eye, written once a frame; a node's boxes follow each other and are the instances of one draw, and drawing some
nodes is one call. Boxes are drawn with the technique's depth test, and write neither colour nor depth. Queries
are used again and again; how long the CPU waited for answers is counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter
from typing import Final

import numpy as np

from renderer.scene import Camera
from renderer.visibility.hierarchy import Floats, Rows
from rhi import ColorWrite, CullMode, DepthWrite, Device, FrontFace, OcclusionQuery, StateScope
from rhi.shading import Shader, Storage, Struct, Uniform, instance_index, mat4, vec3, vec4

__rhi_internal__ = True

_CORNERS: Final = np.array([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], np.float32)
_FACES: Final = np.array(
    [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)], np.uint16
)
"""Corners of each side, counter-clockwise seen from outside."""

TRIANGLES: Final = 12
"""Of a box."""


class Corner(Struct):
    """Of a cube from -1 to 1."""

    position: vec3


class Box(Struct):
    """Relative to the eye, with the world's axes."""

    centre: vec3
    half: vec3


class BoxCamera(Struct):
    """From positions relative to the eye to clip space."""

    relative_view_projection: mat4


class BoxShader(Shader):
    """Depth alone."""

    camera: Uniform[BoxCamera]
    boxes: Storage[Box]

    def vertex(self, v: Corner) -> vec4:
        box = self.boxes[instance_index()]
        return self.camera.relative_view_projection @ vec4(box.centre + box.half * v.position, 1.0)

    def fragment(self) -> None:
        pass


class BoxQueries:
    """Asks a device how many samples of boxes pass the depth test.

    Attributes:
        threshold: what passes no more samples than this counts as hidden; above 0, images may differ.
        issued: queries since `begin_frame`; draws, boxes: draws of boxes in them, and their boxes.
        stalled: seconds that the CPU waited for answers since `begin_frame`.
    """

    def __init__(self, device: Device, sizes: Rows, threshold: int = 0) -> None:
        """`sizes` (n,): how many boxes each node has, 1 or more."""
        self.device = device
        self.threshold = threshold
        self.issued = self.draws = self.boxes = 0
        self.stalled = 0.0
        self._program = device.program(BoxShader)
        triangles = np.ascontiguousarray(_FACES[:, [0, 1, 2, 0, 2, 3]]).reshape(-1)
        self._mesh = device.mesh({"position": _CORNERS}, triangles, label="unit cube")
        count = int(sizes.sum())
        self._draws = self._mesh.draws(instances=sizes, base_instance=np.cumsum(sizes) - sizes)
        self._buffer = device.storage(Box, max(count, 1), label="boxes")
        self._camera = device.uniform(BoxCamera(relative_view_projection=np.eye(4)))
        self._rows = np.zeros(count, self._buffer.dtype)
        self._free: list[OcclusionQuery] = []

    def begin_frame(self, camera: Camera, lower: Floats, upper: Floats) -> None:
        """Let the boxes of all nodes, one node's after the other's, be these (k, 3), and count from 0."""
        self.issued = self.draws = self.boxes = 0
        self.stalled = 0.0
        rows = self._rows
        with np.errstate(over="ignore"):  # what is too far for float32 is drawn without being asked for
            rows["centre"] = 0.5 * (lower + upper) - camera.position
            rows["half"] = 0.5 * (upper - lower)
        if len(rows):
            self._buffer.write(rows)
        self._camera.write(BoxCamera(relative_view_projection=camera.relative_view_projection))

    def states(self) -> StateScope:
        """`with queries.states():` around `ask`: boxes leave no trace in the targets."""
        return self.device.states(ColorWrite.OFF, DepthWrite.OFF, CullMode.BACK, FrontFace.COUNTER_CLOCKWISE)

    def ask(self, nodes: Sequence[int]) -> OcclusionQuery:
        """One query about these nodes together; to be given to `answer` or `release`."""
        query = self.take()
        draws = self._draws.take(nodes)
        with query:
            self.device.draw_many(self._program, self._mesh, draws, camera=self._camera, boxes=self._buffer)
        self.draws += len(draws)
        self.boxes += int(draws["instances"].sum())
        return query

    def take(self) -> OcclusionQuery:
        """A query for other draws; it will be begun."""
        self.issued += 1
        return self._free.pop() if self._free else self.device.occlusion_query()

    def answer(self, query: OcclusionQuery) -> bool:
        """Whether more samples than the threshold passed; waits for it if it must. Gives the query back."""
        if query.is_finished:
            samples = query.visible_samples
        else:
            began = perf_counter()
            samples = query.wait()
            self.stalled += perf_counter() - began
        self._free.append(query)
        return samples > self.threshold

    def release(self, query: OcclusionQuery) -> None:
        """Give a query back whose answer doesn't matter any more."""
        self._free.append(query)

    def destroy(self) -> None:
        """Give everything back that was made on the device."""
        for query in self._free:
            query.destroy()
        self._free.clear()
        for resource in (self._mesh, self._buffer, self._camera):
            resource.destroy()
