"""Chooses the triangles of a scene's tessellated surfaces for the view of a frame, before its first pass.

The triangles are written over the indices of the surface's mesh, so that all techniques, visibility algorithms
and shadow maps draw them as they draw any mesh. Nothing depends on earlier frames: after any move of the
camera the triangles are those of the new view at once. While the view stays the same nothing is issued.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from renderer.frame import Effect, Frame, FrameEffects, FramePass, SceneResources
from renderer.scene import Camera, TessellatedSurface
from renderer.scene.arrays import Floats, Indices
from renderer.tessellation.kernels import (
    COUNTER_COUNT,
    GROUP,
    LIMIT_REACHED,
    MAX_LEVELS,
    WRITTEN_COUNTS,
    BeginBisection,
    Bisect,
    FinishBisection,
    Level,
    SurfaceShape,
    SurfaceView,
    VertexBound,
)
from renderer.tessellation.settings import TessellationSettings
from renderer.visibility.command_cache import CommandCache
from rhi import Device, Encoder, Readback
from rhi.math import is_parallel
from rhi.shading import uint

_GROUPS: Final = 16
"""The largest number of work-groups of a dispatch, each of which takes every such group of triangles. How
many there are is known to the device only, and on a CPU each group that finds none costs 2 µs, in some twenty
dispatches."""


class SurfaceTessellation:
    """The triangles of one surface on one device.

    Attributes:
        surface: the surface.
        object_index: the index of its object.
        limited_views: how many of the views so far needed more triangles than the surface's limit, as far as
            is known without waiting. Their triangles are those of as many levels as fit.
    """

    def __init__(self, device: Device, resources: SceneResources, object_index: int) -> None:
        scene = resources.scene
        self.surface: TessellatedSurface = scene.tessellated[object_index]
        self.object_index = object_index
        self.limited_views = 0
        self._device = device
        self._resources = resources
        mesh, surface = int(scene.objects.mesh[object_index]), self.surface
        stride = scene.meshes.vertices.itemsize // 4
        self._shape = device.uniform(
            SurfaceShape(
                side=surface.side,
                grids=surface.grid_count,
                halves=surface.half_count,
                levels=surface.levels,
                limit=surface.limit,
                first=int(scene.meshes.ranges["first_index"][mesh]),
                first_float=stride * int(scene.meshes.ranges["base_vertex"][mesh]),
                stride=stride,
                mesh=mesh,
                draw=int(np.searchsorted(resources.tessellated_indices, object_index)),
            )
        )
        length, reach = surface.bounds
        bounds: Any = np.zeros(length.size, VertexBound.dtype)
        for name, values in (("length", length), ("reach", reach)):
            bounds[name] = np.nextafter(values.reshape(-1).astype(np.float32), np.float32(np.inf))
        self._bounds = device.storage(VertexBound, bounds, label="tessellated surface")
        self._counters = device.storage(uint, COUNTER_COUNT, label="triangle counts")
        self._split = [device.storage(uint, 3 * surface.limit, label="triangles to split") for _ in range(2)]
        self._levels = [device.uniform(Level(number=number)) for number in range(surface.levels)]
        self._view: SurfaceView | None = None
        self._constants = device.uniform(_no_view())
        self._repeated = CommandCache(device, "tessellation")
        self._pending: Readback | None = None

    def update(self, camera: Camera, settings: TessellationSettings, height: int) -> None:
        """Choose the triangles for a view in an image of `height` pixels; see `Tessellator`."""
        self._read_limit()
        node = self._resources.scene.objects.node[self.object_index]
        view = view_surface(self._resources.scene.nodes.world[node], camera, settings, height)
        if view == self._view:
            return
        self._view = view
        self._constants.write(view)
        self._repeated.execute((), self._issue)
        self._resources.tessellations += 1
        if self._pending is None:
            self._pending = self._counters.read_async(LIMIT_REACHED, 1)

    def _read_limit(self) -> None:
        if self._pending is not None and self._pending.done:
            self.limited_views += int(self._pending.result()[0])
            self._pending = None

    def _issue(self, encoder: Encoder) -> None:
        device, resources = self._device, self._resources
        shared: dict[str, Any] = {
            "shape": self._shape,
            "counters": self._counters,
            "indices": resources.indices,
        }
        test: dict[str, Any] = {
            "view": self._constants,
            "bounds": self._bounds,
            "vertices": resources.vertex_floats,
        }
        encoder.dispatch(
            device.program(BeginBisection),
            1,
            split=self._split[0],
            draws=resources.tessellated_draws,
            **shared,
            **test,
        )
        for number, level in enumerate(self._levels):
            most = min(self.surface.half_count << number, self.surface.limit)
            encoder.dispatch(
                device.program(Bisect),
                min(-(-most // GROUP), _GROUPS),
                level=level,
                split=self._split[number % 2],
                children=self._split[1 - number % 2],
                **shared,
                **test,
            )
        encoder.dispatch(
            device.program(FinishBisection),
            _GROUPS,
            draws=resources.tessellated_draws,
            parts=resources.mesh_parts,
            **shared,
        )

    def read_count(self) -> int:
        """Return the number of triangles of the last view. Waits for the device."""
        counts = self._counters.read(WRITTEN_COUNTS, MAX_LEVELS + 1)
        return int(counts.sum())

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._repeated.forget()
        for resource in (
            self._shape,
            self._bounds,
            self._counters,
            self._constants,
            *self._split,
            *self._levels,
        ):
            resource.destroy()


class Tessellator:
    """The tessellated surfaces of a scene on one device; `Renderer.tessellator` is the one of a renderer.

    Attributes:
        settings: how small triangles are; they may be exchanged between any two frames.
        surfaces: the surfaces, as they are drawn; none before the first frame.
    """

    def __init__(self, device: Device) -> None:
        self.settings = TessellationSettings()
        self.surfaces: list[SurfaceTessellation] = []
        self._device = device

    def update(
        self, resources: SceneResources, camera: Camera, height: int, *, has_shadows: bool = False
    ) -> None:
        """Choose the triangles for what `camera` sees in an image of `height` pixels. Paused surfaces that
        cast no shadow keep theirs until they are drawn, and then get those of this frame. Those that wait for
        their uploads have none to choose."""
        objects = resources.scene.objects
        if not self.surfaces:
            self.surfaces = [
                SurfaceTessellation(self._device, resources, object_index)
                for object_index in resources.scene.tessellated
            ]

        def choose(object_indices: Indices) -> None:
            for surface in self.surfaces:
                index = surface.object_index
                if index in object_indices and objects.is_shown[index]:
                    surface.update(camera, self.settings, height)

        casts = objects.casts_shadow & has_shadows
        choose(np.flatnonzero(~resources.hidden.paused | casts))
        resources.resume = choose

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        for surface in self.surfaces:
            surface.destroy()
        self.surfaces = []


def tessellation_passes(effects: FrameEffects) -> list[FramePass[Frame]]:
    """Return the pass that chooses triangles, if the scene has a tessellated surface."""
    effect = Effect.TESSELLATION
    if effect not in effects.enabled:
        return []
    return [FramePass("tessellation", _update, effects.explain(effect), has_side_effects=True)]


def _update(frame: Frame) -> None:
    if frame.device.capabilities.compute:  # the second of two eyes asks for the same as the first
        tessellator = frame.resources.workspace(Tessellator)
        has_shadows = frame.effects.has_shadow_casters
        tessellator.update(frame.resources, frame.view.around, frame.targets.size[1], has_shadows=has_shadows)


def view_surface(world: Floats, camera: Camera, settings: TessellationSettings, height: int) -> SurfaceView:
    """Return a view in the space of a surface.

    Args:
        world: the transform (4, 4) of the surface.
    """
    linear = world[:3, :3]
    most, _, least = np.linalg.svd(linear, compute_uv=False).tolist()
    if least <= 1e-9 * most:
        return _no_view()
    offset = world[:3, 3] - camera.position
    scale = 0.5 * height * float(camera.projection.matrix[1, 1]) / settings.edge_pixels
    planes = camera.frustum.planes
    ends = planes[:, 3] + planes[:, :3] @ camera.position
    inside = np.zeros((6, 4), np.float32)
    inside[:, 3] = -1.0
    inside[: len(planes), :3] = planes[:, :3] @ linear / most
    inside[: len(planes), 3] = -(planes[:, :3] @ offset + ends) / most
    if is_parallel(camera.projection):
        return SurfaceView(
            depth=(0.0, 0.0, 0.0, -1.0),
            eye=(0.0, 0.0, 0.0),
            scale=scale * most,
            out_of_view_scale=scale * most / settings.out_of_view_scale,
            squared_axis_ratio=0.0,
            is_perspective=0.0,
            planes=inside,
        )
    depth = np.append(camera.forward @ linear, -camera.forward @ offset) / most
    return SurfaceView(
        depth=depth,
        eye=np.linalg.solve(linear, -offset),
        scale=scale,
        out_of_view_scale=scale / settings.out_of_view_scale,
        squared_axis_ratio=(least / most) ** 2,
        is_perspective=1.0,
        planes=inside,
    )


def _no_view() -> SurfaceView:
    """Return a view that splits nothing."""
    return SurfaceView(
        depth=(0.0, 0.0, 0.0, -1.0),
        eye=(0.0, 0.0, 0.0),
        scale=0.0,
        out_of_view_scale=0.0,
        squared_axis_ratio=0.0,
        is_perspective=0.0,
        planes=np.zeros((6, 4), np.float32),
    )
