"""Views: what a frame is seen from, one for each eye or light that draws the scene."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from renderer import shaders
from renderer.frame.batch import BatchCommands, FrameBatch
from renderer.frame.far_objects import FarObjects
from renderer.frame.mirrors import MirroredValue, R, Releasable, S, Workspaces, split_doubles
from renderer.scene import Camera
from renderer.visibility import VisibilityAlgorithm
from rhi import Device, UniformBuffer


class View:
    """A camera, and the algorithm that finds the visible objects, with its state of the last frames.

    The first pass of a view in a frame finds the visible objects, by a visibility algorithm that may issue
    commands of its own. Each further pass draws the same objects again (`Frame.draw_visible`). So the objects
    of a view are found once a frame, however many passes draw them.

    Attributes:
        name: what the view is called in plans and events.
        visibility: the algorithm; it may be exchanged between two frames.
        batch: the draws of its first pass, if these are one batch.
        commands: those that draw the batch, pass by pass.
        around: a camera that sees all that the frame's views see, this one's camera if there is only one.
        camera: the camera of this frame. A view must be aimed before it is used.
        buffer: the camera's constants for shaders.
        split_eye: the eye's position as pairs of floats.
        far: what the view shares with another eye's; None if that is nothing.
    """

    around: Camera
    camera: Camera
    buffer: UniformBuffer[shaders.ViewConstants]
    split_eye: tuple[NDArray[np.float32], NDArray[np.float32]]

    def __init__(
        self, device: Device, name: str, visibility: VisibilityAlgorithm, batch: FrameBatch | None = None
    ) -> None:
        """`batch` is shared with another view, which destroys it."""
        self.name = name
        self.far: FarObjects | None = None
        self.visibility = visibility
        self.batch = batch or FrameBatch(device)
        self.commands = BatchCommands(device)
        self._owns_batch = batch is None
        self._workspaces = Workspaces(device)
        constants = shaders.ViewConstants(
            relative_view_projection=np.eye(4), eye_high=np.zeros(3), eye_low=np.zeros(3)
        )
        self._constants = MirroredValue(device, constants)
        self.buffer = self._constants.buffer

    def mirror(self, value: S) -> UniformBuffer[S]:
        """The uniform buffer for this type of struct, written if the value has changed."""
        return self._workspaces.mirror(value)

    def workspace(self, kind: Callable[[Device], R]) -> R:
        """A technique's state between frames of this view: `kind(device)`, created on first use and
        destroyed with the view."""
        return self._workspaces.get_or_create(kind)

    def release(self, kind: Callable[[Device], Releasable]) -> None:
        """Release a workspace, if it exists: it destroys what it can create again."""
        self._workspaces.release(kind)

    def aim(self, camera: Camera, around: Camera | None = None) -> None:
        """Set the camera of the next frame; its constants are uploaded if they have changed.

        Args:
            around: a camera that sees at least as much, with which objects are sought for several views at
                once.
        """
        self.camera = camera
        self.around = around or camera
        self.commands.pass_index = 0
        self.batch.last_order = None
        high, low = self.split_eye = split_doubles(camera.position)
        matrix = camera.relative_view_projection
        constants = shaders.ViewConstants(
            relative_view_projection=matrix,
            eye_high=high.tolist(),  # numbers of Python are packed faster than an array
            eye_low=low.tolist(),
        )
        self._constants.write(constants)

    def destroy(self) -> None:
        """Destroy the buffers and workspaces. The algorithm is not destroyed."""
        if self._owns_batch:
            self.batch.destroy()
        self._workspaces.destroy()
        self._constants.destroy()
