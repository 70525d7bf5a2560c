"""The pass that a visibility algorithm draws the scene in, and the scene's arrays on the device.

`SceneDrawer` is all that an algorithm gets of a renderer. An algorithm of the CPU draws objects by index: all
in a pass of their own, or in several batches in an open pass. One that runs on the device opens and closes
the pass itself: it draws lists that the device has made, dispatches compute work between them, which has to
happen outside of passes, and reads the pass's depth.

Techniques implement `SceneDrawer` with `renderer.frame.TechniqueDrawer`. `CallbackDrawer` is for tools and
tests.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NoReturn, Protocol

from renderer import rules
from renderer.scene import Camera
from renderer.scene.arrays import Indices
from renderer.shaders import ListEntry, Meshlet, MeshPart, Object, ObjectPosition, ViewConstants
from renderer.visibility.boxes.bounds import UNKNOWN_SIZE
from renderer.visibility.detail import DetailConstants
from rhi import Encoder, IndirectDraws, QuerySet, Readback, StorageBuffer, Texture, refuse
from rhi.shading import StorageRange, UniformRange, uint


@dataclass(frozen=True, slots=True)
class SceneArrays:
    """The buffers of a scene on a device, as shaders read them.

    An object is an element of `objects` and of `object_positions`; its index is the base instance of its
    draw. A mesh is an element of `mesh_parts`, and that of an object is in `object_meshes`. The objects of an
    instance set are neighbours in `list_entries`, from one of `set_begins` to the next. `detail` is the limit of
    levels of detail, None if no mesh has any. `meshlets` has the bounds of the elements of `mesh_parts`, None if lists
    have no meshlets.
    """

    view: UniformRange[ViewConstants]
    objects: StorageRange[Object]
    object_positions: StorageRange[ObjectPosition]
    mesh_parts: StorageRange[MeshPart]
    object_meshes: StorageRange[int]
    list_entries: StorageRange[ListEntry]
    set_begins: StorageRange[uint]
    detail: UniformRange[DetailConstants] | None = None
    meshlets: StorageRange[Meshlet] | None = None


class DeviceDrawList(Protocol):
    """A list of draws that the device has made.

    Attributes:
        generation: how often the list was made; a different number means a different list.
        objects, object_positions: those of the scene that the draws' instances read.
    """

    generation: int
    objects: StorageBuffer[Object]
    object_positions: StorageBuffer[ObjectPosition]

    def arguments(self, part: int) -> IndirectDraws:
        """Return the draws of the objects whose `ObjectPosition.draw_list` is `part`."""
        ...

    def read_object_indices(self) -> Indices:
        """Return the indices of the listed objects. Waits for the device."""
        ...

    def read_object_indices_async(self) -> Callable[[], Indices]:
        """Begin to read the indices of the listed objects, and return a function that returns them. That
        waits for the device."""
        ...

    def read_marks(self, first_object: int, count: int) -> Readback:
        """Begin to read the marks (`count`,) of the objects from `first_object` on: `occludees.HIDDEN` and
        others."""
        ...


class SceneDrawer(Protocol):
    """The render pass in which a technique draws the scene.

    The pass may be closed and opened again: what was drawn is kept.
    """

    @property
    def arrays(self) -> SceneArrays:
        """The scene's buffers, up to date for this frame."""
        ...

    @property
    def meshlet_arrays(self) -> SceneArrays | None:
        """The same with meshlets in place of the meshes that are cut; None if no object has such a mesh."""
        ...

    @property
    def depth(self) -> Texture:
        """The depth target. It may be read, or used in another pass, while this pass is closed."""
        ...

    @property
    def size(self) -> tuple[int, int]:
        """The width and the height of the image in pixels."""
        ...

    @property
    def key(self) -> tuple[object, ...]:
        """The values that this pass's commands depend on, besides what is drawn: the key of commands that are
        repeated (`CommandCache`)."""
        ...

    def widen(self, camera: Camera) -> Camera:
        """Return a camera that sees all that the frame's eyes see, at least what `camera` sees. Objects in
        its frustum are those of all eyes."""
        ...

    def open(self) -> None:
        """Begin the pass unless it is open."""
        ...

    def close(self) -> None:
        """End the pass if it is open. The next draw opens it again."""
        ...

    def draw_alone(self, object_indices: Indices) -> None:
        """Draw the objects `object_indices` (k,) in a pass of their own. Call it in each frame that draws
        nothing else: then the commands are recorded once."""
        ...

    def draw(self, object_indices: Indices) -> None:
        """Draw the objects `object_indices` (k,) now, before anything that is issued later; opens the pass if
        it is closed."""
        ...

    def draw_conditional(self, object_indices: Indices, queries: QuerySet, query_indices: Indices) -> None:
        """Draw the objects `object_indices` (k,), each on condition that its query of the set, of index
        `query_indices[i]` (k,), counted a sample. The device decides."""
        ...

    def begin_list(self, draws: DeviceDrawList) -> None:
        """Note that the device lists and draws objects in this frame, before its commands are executed."""
        ...

    def draw_list(self, encoder: Encoder, draws: DeviceDrawList, *, first: bool) -> None:
        """Draw the objects that the device has listed, in a pass of their own. The `first` list of a frame
        clears the targets if nothing else has."""
        ...


class CallbackDrawer:
    """A `SceneDrawer` without a device, which hands the rows of each batch to a function; for tools and
    tests.

    It has neither buffers nor depth, so algorithms that need them are refused (`visibility-no-renderer`).
    """

    def __init__(self, draw: Callable[[Indices], object]) -> None:
        """`draw` is called with the indices (k,) of each batch, in the order of the draws."""
        self._draw = draw

    @property
    def arrays(self) -> SceneArrays:
        """Refused: there is no device."""
        self._refuse("arrays")

    @property
    def meshlet_arrays(self) -> SceneArrays | None:
        """Refused: there is no device."""
        self._refuse("meshlet_arrays")

    @property
    def depth(self) -> Texture:
        """Refused: there is no target."""
        self._refuse("depth")

    @property
    def size(self) -> tuple[int, int]:
        """The size of an image of many pixels: there is no target."""
        return UNKNOWN_SIZE

    @property
    def key(self) -> tuple[object, ...]:
        """Refused: there is no device."""
        self._refuse("key")

    def widen(self, camera: Camera) -> Camera:
        """Return `camera`: there is no other eye."""
        return camera

    def open(self) -> None:
        """Do nothing: there is no pass to begin."""

    def close(self) -> None:
        """Do nothing: there is no pass to end."""

    def draw_alone(self, object_indices: Indices) -> None:
        """Hand the indices (k,) to the function."""
        self._draw(object_indices)

    def draw(self, object_indices: Indices) -> None:
        """Hand the indices (k,) to the function."""
        self._draw(object_indices)

    def draw_conditional(self, object_indices: Indices, queries: QuerySet, query_indices: Indices) -> None:
        """Hand the indices (k,) to the function: all of them may be drawn."""
        self._draw(object_indices)

    def begin_list(self, draws: DeviceDrawList) -> None:
        """Refused: there is no device."""
        self._refuse("begin_list")

    def draw_list(self, encoder: Encoder, draws: DeviceDrawList, *, first: bool) -> None:
        """Refused: there is no device."""
        self._refuse("draw_list")

    def _refuse(self, name: str) -> NoReturn:
        refuse(rules.NO_RENDERER, f"CallbackDrawer.{name}", "a pass without a device", "a renderer's pass")
