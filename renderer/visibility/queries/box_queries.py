"""Occlusion queries of bounding boxes, issued in the middle of a technique's pass (thesis 6.2, steps 1 to 4).

A query is about nodes, each of which has one box or several. All boxes are rows of one array, relative to the
eye, written once a frame. A node's boxes are consecutive rows and the instances of one draw; the draws of
several nodes are one call. The directions of the boxes' axes are another array, written when they change.
Boxes are drawn with the technique's depth test, and write neither colour nor depth. The time for which the
CPU waits for results is counted.

Many nodes are asked about at once with a query set, which is one call and one answer. Query sets and single
queries are reused.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.scene import Camera
from renderer.scene.arrays import Indices
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
    axes: Storage[QueryBoxAxes]

    def vertex(self, v: CubeCorner) -> vec4:
        box = self.boxes[instance_index()]
        turn = self.axes[instance_index()]
        corner = box.half * v.position
        position = box.centre + turn.x * corner.x + turn.y * corner.y + cross(turn.x, turn.y) * corner.z
        return self.camera.relative_view_projection @ vec4(position, 1.0)

    def fragment(self) -> None:
        pass


class BoxQueries:
    """Queries a device for whether boxes pass the depth test, and reuses the query objects.

    Attributes:
        threshold: a query with at most this many samples counts as hidden; above 0, images may differ.
        emulated: whether the queries are emulated by two counters and a fence, even if the device has its
            own.
        queried: for each node whether it was queried since `begin_frame`.
        issued: queries since `begin_frame`.
        draws, boxes: draws of boxes in them, and the boxes drawn.
        stalled: seconds for which the CPU waited for results since `begin_frame`.
    """

    def __init__(
        self, device: Device, sizes: Indices, box_indices: Indices, threshold: int = 0, emulated: bool = False
    ) -> None:
        """`sizes` (n,) is the number of boxes of each node, 1 or more; `box_indices` are those of its boxes,
        node after node."""
        self.device = device
        self.threshold = threshold
        self.emulated = emulated
        self.issued = self.draws = self.boxes = 0
        self.stalled = 0.0
        self.queried = bytearray(len(sizes))
        self._none_queried = bytes(len(sizes))
        self._program = device.program(QueryBoxShader)
        self._mesh = make_cube(device)
        self._camera = device.uniform(BoxCamera(relative_view_projection=np.eye(4)))
        self._make_buffers(max(len(box_indices), 1))
        self.set_nodes(sizes, box_indices)
        self._created: list[
            OcclusionQuery | QuerySet
        ] = []  # also those in flight, and those of a frame that raised
        self._free: list[OcclusionQuery] = []
        self._free_sets: dict[int, list[QuerySet]] = {}  # by size

    def set_nodes(self, sizes: Indices, box_indices: Indices) -> None:
        """Give the nodes other boxes; the arguments are those of the constructor."""
        if len(box_indices) > len(self._buffer):
            old = self._buffer, self._axes
            self._make_buffers(len(box_indices) + len(box_indices) // 2)
            for buffer in old:
                buffer.destroy()
        self._box_indices = np.asarray(
            box_indices, np.intp
        )  # `take` refuses others where pointers have 32 bits
        self._draws = self._mesh.draws(instances=sizes, base_instance=np.cumsum(sizes) - sizes)
        # Rows of `QueryBox` as plain floats: gathering whole rows is ten times as fast as gathering each
        # field.
        self._rows = np.zeros((len(box_indices), 8), np.float32)
        self._directions: tuple[NDArray[np.float32], ...] = (
            np.zeros((0, 3), np.float32),
        ) * 2  # those on the device

    def _make_buffers(self, room: int) -> None:
        boxes = self.device.storage(QueryBox, room, label="boxes")
        self._axes = self.device.storage(QueryBoxAxes, room, label="axes of boxes")
        self._buffer = boxes  # the last one, since its length tells how much room both have

    def begin_frame(self, camera: Camera, boxes: QueryBoxes) -> None:
        """Upload the boxes of all nodes, gathered from `boxes`, and reset the counters."""
        self.queried[:] = self._none_queried
        self.issued = self.draws = self.boxes = 0
        self.stalled = 0.0
        self._camera.write(BoxCamera(relative_view_projection=camera.relative_view_projection))
        rows, box_indices = self._rows, self._box_indices
        if not len(rows):
            return
        box_rows = np.zeros((len(boxes.centre), 8), np.float32)
        with np.errstate(over="ignore"):  # what is too far for float32 is drawn without a query
            box_rows[:, 0:3] = boxes.centre - camera.position
            box_rows[:, 4:7] = boxes.half
        box_rows.take(box_indices, axis=0, out=rows, mode="clip")  # "clip" avoids a copy
        self._buffer.write(rows.view(self._buffer.dtype)[:, 0])
        directions = (boxes.x, boxes.y)
        if not all(map(np.array_equal, self._directions, directions)):
            axes = np.zeros(len(box_indices), self._axes.dtype)
            axes["x"], axes["y"] = boxes.x[box_indices], boxes.y[box_indices]
            self._axes.write(axes)
            self._directions = directions

    def states(self) -> StateScope:
        """Return the state scope to issue queries in, in which boxes change no target: `with
        queries.states():`."""
        return self.device.states(ColorWrite.OFF, DepthWrite.OFF, CullMode.BACK, FrontFace.COUNTER_CLOCKWISE)

    def issue(self, nodes: Sequence[int]) -> OcclusionQuery:
        """Issue one query for all boxes of `nodes`. Pass the query to `resolve` or `release` later."""
        queried = self.queried
        for node in nodes:
            queried[node] = 1
        query = self.acquire()
        draws = self._draws.take(nodes)
        with query:
            self.device.draw_many(
                self._program,
                self._mesh,
                draws,
                camera=self._camera,
                boxes=self._buffer,
                axes=self._axes,
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
        self._created.append(query)
        return query

    def resolve(self, query: OcclusionQuery) -> bool:
        """Return whether more samples than the threshold passed, and release the query. Waits for the result
        if it is not yet available."""
        samples: int = self._read_samples(query)
        self._free.append(query)
        return samples > self.threshold

    def release(self, query: OcclusionQuery) -> None:
        """Make a query reusable without reading its result."""
        self._free.append(query)

    def issue_set(self, nodes: Sequence[int], query_indices: Sequence[int]) -> QuerySet:
        """Query the boxes of `nodes` in one call. Node i is counted by query `query_indices[i]` of the set;
        nodes with the same query are consecutive, and indices go from 0 up. Pass the set to `read` or
        `release_set` later."""
        queries = self._acquire_set(query_indices[-1] + 1)
        draws = self._draws.take(nodes)
        queried = self.queried
        for node in nodes:
            queried[node] = 1
        try:
            self.device.draw_counted(
                self._program,
                self._mesh,
                draws,
                queries,
                np.asarray(query_indices),
                camera=self._camera,
                boxes=self._buffer,
                axes=self._axes,
            )
        except BaseException:
            self.release_set(queries)
            raise
        self.issued += query_indices[-1] + 1
        self.draws += len(draws)
        self.boxes += int(draws["instances"].sum())
        return queries

    def _acquire_set(self, count: int) -> QuerySet:
        """Return an unused set of at least so many rows, fewer than twice as many."""
        size = 1 << (count - 1).bit_length()
        free = self._free_sets.setdefault(size, [])
        if free:
            return free.pop()
        queries = self.device.query_set(size, emulated=self.emulated)
        self._created.append(queries)
        return queries

    def read(self, queries: QuerySet) -> list[bool]:
        """Return for each row of a set whether more samples than the threshold passed, and release the set.
        Waits for the results if they are not yet available."""
        samples: NDArray[np.int64] = self._read_samples(queries)
        self.release_set(queries)
        shows: list[bool] = (samples > self.threshold).tolist()
        return shows

    def _read_samples(self, queried: OcclusionQuery | QuerySet) -> Any:
        """Return the samples that a query or each row of a set has counted, and count the time of a wait for
        them."""
        if queried.is_finished:
            return queried.visible_samples
        began = perf_counter()
        samples = queried.wait()
        self.stalled += perf_counter() - began
        return samples

    def release_set(self, queries: QuerySet) -> None:
        """Make a set reusable without reading its results."""
        self._free_sets[len(queries)].append(queries)

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        for resource in (*self._created, self._mesh, self._buffer, self._axes, self._camera):
            resource.destroy()
