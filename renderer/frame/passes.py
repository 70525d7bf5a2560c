"""A technique's pass over the scene, drawn as the visibility algorithm says, and what was drawn in it."""

from __future__ import annotations

from contextlib import ExitStack
from functools import cached_property
from types import TracebackType
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.frame.resources import SceneResources
from renderer.scene import Camera, Depth, Scene
from renderer.visibility import DeviceList, SceneArrays
from renderer.visibility.boxes.volumes import Containment, classify, fit_aligned
from rhi import CullMode, DepthFunction, DepthTest, DepthWrite, Device, FrontFace, Program, Texture, refuse

_DEPTH: Final = {Depth.REVERSED: (0.0, DepthFunction.GREATER), Depth.STANDARD: (1.0, DepthFunction.LESS)}
"""What depth is cleared to, and the test that the nearer fragment passes."""

_WINDINGS: Final = ((False, FrontFace.COUNTER_CLOCKWISE), (True, FrontFace.CLOCKWISE))


class Drawn:
    """What was drawn: rows that the CPU chose, and lists that the device made.

    A list is read when it is first asked for, which waits for the device, and only as long as the next frame
    hasn't made another.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self.batches: list[NDArray[np.int64]] = []
        self._lists: list[tuple[DeviceList, int]] = []

    def add_list(self, draws: DeviceList) -> None:
        """A list that was drawn."""
        self._lists.append((draws, draws.generation))

    @cached_property
    def rows(self) -> NDArray[np.int64]:
        """Of all objects drawn, in the order of their batches."""
        for draws, generation in self._lists:
            if draws.generation != generation:
                refuse(
                    rules.STALE_LIST, "FrameResult.visible", f"after {draws.generation - generation} others"
                )
        lists = [draws.read_rows() for draws, _ in self._lists]
        return np.concatenate([np.zeros(0, np.int64), *self.batches, *lists])

    @cached_property
    def triangles(self) -> int:
        """Of all objects drawn."""
        return self._scene.count_triangles(self.rows)


class TechniquePass:
    """The scene drawn with one program to one set of targets; a visibility algorithm decides what and when.

    The pass may be closed and opened again; it is cleared when it is first opened. Rows are drawn in one call,
    front to back, for what is near hides what is drawn after it: by the depth of their boxes' farthest corners, so
    that what stands on a wide ground is drawn before the ground. Those whose transform mirrors them need the other
    winding, and another call.

    Attributes:
        depth: the depth target. drawn: what was drawn. was_opened: whether the pass was ever open.
    """

    def __init__(
        self,
        device: Device,
        resources: SceneResources,
        camera: Camera,
        program: Program[Any],
        bindings: dict[str, Any],
        *,
        color: Texture | list[Texture] | None,
        depth: Texture,
        clear: tuple[float, float, float, float],
    ) -> None:
        self.depth = depth
        self.drawn = Drawn(resources.scene)
        self._device = device
        self._resources = resources
        self._camera = camera
        self._program = program
        self._bindings = bindings
        self._color = color
        self._clear = clear
        self.was_opened = False
        self._scopes: ExitStack | None = None

    @property
    def arrays(self) -> SceneArrays:
        """The scene, up to date."""
        return self._resources.arrays

    def open(self) -> None:
        """Begin the pass, unless it is open."""
        if self._scopes is not None:
            return
        far, nearer = _DEPTH[self._camera.projection.depth]
        begins = not self.was_opened
        with ExitStack() as scopes:
            scopes.enter_context(
                self._device.render_pass(
                    self._color,
                    self.depth,
                    clear=self._clear if begins and self._color is not None else None,
                    clear_depth=far if begins else None,
                )
            )
            scopes.enter_context(self._device.states(CullMode.BACK, DepthTest.ON, DepthWrite.ON, nearer))
            self._scopes = scopes.pop_all()
        self.was_opened = True

    def close(self) -> None:
        """End the pass, if it is open; what was drawn is kept."""
        self.__exit__(None, None, None)

    def draw(self, rows: NDArray[np.int64]) -> None:
        """Draw the objects with these rows."""
        self.open()
        self.drawn.batches.append(rows)
        resources = self._resources
        resources.simulate(rows)
        if len(rows) > 1:
            objects, forward = resources.scene.objects, self._camera.forward
            far = np.where(forward > 0.0, objects.upper[rows], objects.lower[rows]) @ forward
            rows = rows[np.argsort(far, kind="stable")]
        for turned, winding in _WINDINGS:
            part = resources.take_winding(rows, mirrored=turned)
            if part.size:
                with self._device.states(winding):
                    self._device.draw_many(
                        self._program, resources.mesh, resources.draws[part], **self._bindings
                    )

    def draw_list(self, draws: DeviceList) -> None:
        """Draw what the device has listed; of what is simulated, it may list all that is not outside the view."""
        self.open()
        simulated = self._resources.simulator.objects
        if len(simulated):
            side = classify(self._camera.frustum.planes, fit_aligned(self._resources.scene, simulated))
            self._resources.simulate(simulated[side != Containment.OUTSIDE])
        self.drawn.add_list(draws)
        for turned, winding in _WINDINGS:
            if self._resources.has_winding(mirrored=turned):
                with self._device.states(winding):
                    self._device.draw_indirect(
                        self._program,
                        self._resources.mesh,
                        draws.arguments(mirrored=turned),
                        **self._bindings,
                    )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        scopes, self._scopes = self._scopes, None
        if scopes is not None:
            scopes.__exit__(kind, error, trace)
