"""Occlusion queries of bounding boxes, issued in the middle of a technique's pass (thesis 6.2, steps 1 to 4).

A query is about nodes, each of which has one box or several. All boxes are rows of one array, relative to the eye,
written once a frame. A node's boxes are consecutive rows and the instances of one draw; the draws of several nodes
are one call. The directions of the boxes' axes are another array, written when they change. Boxes are drawn with the
technique's depth test, and write neither colour nor depth. The time for which the CPU waits for results is counted.

Many nodes are asked about at once with a query set, which is one call and one answer. Query sets and single queries
are reused.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.scene import Camera
from renderer.scene.arrays import Rows
from renderer.visibility.boxes.bounds import QueryBoxes
from renderer.visibility.boxes.cubes import BoxCamera, CubeCorner, make_cube
from rhi import ColorWrite, CullMode, DepthWrite, Device, FrontFace, OcclusionQuery, QuerySet, StateScope
from rhi.shading import Shader, Storage, Struct, Uniform, cross, instance_index, vec3, vec4


class QueryBox(Struct):
    """A box: its centre relative to the eye, and half its size along its own axes."""

    centre: vec3
    half: vec3


class QueryBoxAxes(Struct):
    """The orientation of a box: unit vectors along its first two axes. The third is their cross product."""

    x: vec3
    y: vec3


class QueryBoxShader(Shader):
    """Draws boxes with no output but depth."""

    camera: Uniform[BoxCamera]
    boxes: Storage[QueryBox]
    turns: Storage[QueryBoxAxes]

    def vertex(self, v: CubeCorner) -> vec4:
        box = self.boxes[instance_index()]
        turn = self.turns[instance_index()]
        corner = box.half * v.position
        place = box.centre + turn.x * corner.x + turn.y * corner.y + cross(turn.x, turn.y) * corner.z
        return self.camera.relative_view_projection @ vec4(place, 1.0)

    def fragment(self) -> None:
        pass


class BoxQueries:
    """Queries a device for whether boxes pass the depth test, and reuses the query objects.

    Attributes:
        threshold: a query with at most this many samples counts as hidden; above 0, images may differ.
        emulated: whether the queries are emulated by two counters and a fence, even if the device has its own.
        asked: for each node whether it was queried since `begin_frame`.
        issued: queries since `begin_frame`. draws, boxes: draws of boxes in them, and the boxes drawn.
        stalled: seconds for which the CPU waited for results since `begin_frame`.
    """

    def __init__(self, device: Device, sizes: Rows, members: Rows, threshold: int = 0, emulated: bool = False) -> None:
        """`sizes` (n,) is the number of boxes of each node, 1 or more; `members` are their rows, node after node."""
        self.device = device
        self.threshold = threshold
        self.emulated = emulated
        self.issued = self.draws = self.boxes = 0
        self.stalled = 0.0
        self.asked = bytearray(len(sizes))
        self._none_asked = bytes(len(sizes))
        self._program = device.program(QueryBoxShader)
        self._mesh = make_cube(device)
        self._camera = device.uniform(BoxCamera(relative_view_projection=np.eye(4)))
        self._make_buffers(max(len(members), 1))
        self.arrange(sizes, members)
        self._made: list[OcclusionQuery | QuerySet] = []  # also those in flight, and those of a frame that raised
        self._free: list[OcclusionQuery] = []
        self._free_sets: dict[int, list[QuerySet]] = {}  # by size

    def arrange(self, sizes: Rows, members: Rows) -> None:
        """Give the nodes other boxes; the arguments are those of the constructor."""
        if len(members) > len(self._buffer):
            self._buffer.destroy()
            self._turns.destroy()
            self._make_buffers(len(members) + len(members) // 2)
        self._members = members
        self._draws = self._mesh.draws(instances=sizes, base_instance=np.cumsum(sizes) - sizes)
        # Rows of `QueryBox` as plain floats: gathering whole rows is ten times as fast as gathering each field.
        self._rows = np.zeros((len(members), 8), np.float32)
        self._directions: tuple[NDArray[np.float32], ...] = (np.zeros((0, 3), np.float32),) * 2  # those on the device

    def _make_buffers(self, room: int) -> None:
        self._buffer = self.device.storage(QueryBox, room, label="boxes")
        self._turns = self.device.storage(QueryBoxAxes, room, label="turns of boxes")

    def begin_frame(self, camera: Camera, boxes: QueryBoxes) -> None:
        """Upload the boxes of all nodes, gathered from `boxes`, and reset the counters."""
        self.asked[:] = self._none_asked
        self.issued = self.draws = self.boxes = 0
        self.stalled = 0.0
        self._camera.write(BoxCamera(relative_view_projection=camera.relative_view_projection))
        rows, members = self._rows, self._members
        if not len(rows):
            return
        each = np.zeros((len(boxes.centre), 8), np.float32)
        with np.errstate(over="ignore"):  # what is too far for float32 is drawn without a query
            each[:, 0:3] = boxes.centre - camera.position
            each[:, 4:7] = boxes.half
        each.take(members, axis=0, out=rows, mode="clip")  # "clip" avoids a copy
        self._buffer.write(rows.view(self._buffer.dtype)[:, 0])
        directions = (boxes.x, boxes.y)
        if not all(map(np.array_equal, self._directions, directions)):
            turns = np.zeros(len(members), self._turns.dtype)
            turns["x"], turns["y"] = boxes.x[members], boxes.y[members]
            self._turns.write(turns)
            self._directions = directions

    def states(self) -> StateScope:
        """Return the state scope to issue queries in, in which boxes change no target: `with queries.states():`."""
        return self.device.states(ColorWrite.OFF, DepthWrite.OFF, CullMode.BACK, FrontFace.COUNTER_CLOCKWISE)

    def issue(self, nodes: Sequence[int]) -> OcclusionQuery:
        """Issue one query for all boxes of `nodes`. Pass the query to `resolve` or `release` later."""
        asked = self.asked
        for node in nodes:
            asked[node] = 1
        query = self.acquire()
        draws = self._draws.take(nodes)
        with query:
            self.device.draw_many(
                self._program,
                self._mesh,
                draws,
                camera=self._camera,
                boxes=self._buffer,
                turns=self._turns,
            )
        self.draws += len(draws)
        self.boxes += int(draws["instances"].sum())
        return query

    def acquire(self) -> OcclusionQuery:
        """Return an unused query for draws of the caller's own, and count it as issued."""
        self.issued += 1
        if self._free:
            return self._free.pop()
        query = self.device.occlusion_query(emulated=self.emulated)
        self._made.append(query)
        return query

    def resolve(self, query: OcclusionQuery) -> bool:
        """Return whether more samples than the threshold passed, and release the query. Waits for the result if it is
        not yet available."""
        samples: int = self._take_answer(query)
        self._free.append(query)
        return samples > self.threshold

    def release(self, query: OcclusionQuery) -> None:
        """Make a query reusable without reading its result."""
        self._free.append(query)

    def ask(self, nodes: Sequence[int], rows: Sequence[int]) -> QuerySet:
        """Query the boxes of `nodes` in one call. Node i is counted by row `rows[i]` of the set; nodes with the same
        row are consecutive, and rows go from 0 up. Pass the set to `read` or `release_set` later."""
        queries = self._acquire_set(rows[-1] + 1)
        draws = self._draws.take(nodes)
        asked = self.asked
        for node in nodes:
            asked[node] = 1
        try:
            self.device.draw_counted(
                self._program,
                self._mesh,
                draws,
                queries,
                np.asarray(rows),
                camera=self._camera,
                boxes=self._buffer,
                turns=self._turns,
            )
        except BaseException:
            self.release_set(queries)
            raise
        self.issued += rows[-1] + 1
        self.draws += len(draws)
        self.boxes += int(draws["instances"].sum())
        return queries

    def _acquire_set(self, rows: int) -> QuerySet:
        """Return an unused set of at least so many rows, fewer than twice as many."""
        size = 1 << (rows - 1).bit_length()
        free = self._free_sets.setdefault(size, [])
        if free:
            return free.pop()
        queries = self.device.query_set(size, emulated=self.emulated)
        self._made.append(queries)
        return queries

    def read(self, queries: QuerySet) -> list[bool]:
        """Return for each row of a set whether more samples than the threshold passed, and release the set. Waits for
        the results if they are not yet available."""
        samples: NDArray[np.int64] = self._take_answer(queries)
        self.release_set(queries)
        shows: list[bool] = (samples > self.threshold).tolist()
        return shows

    def _take_answer(self, asked: OcclusionQuery | QuerySet) -> Any:
        """Return the samples that a query or each row of a set has counted, and count the time of a wait for them."""
        if asked.is_finished:
            return asked.visible_samples
        began = perf_counter()
        samples = asked.wait()
        self.stalled += perf_counter() - began
        return samples

    def release_set(self, queries: QuerySet) -> None:
        """Make a set reusable without reading its results."""
        self._free_sets[len(queries)].append(queries)

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        for resource in (*self._made, self._mesh, self._buffer, self._turns, self._camera):
            resource.destroy()
