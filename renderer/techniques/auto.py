"""The technique that measures others: which one is the fastest depends on the scene, the view and the device.

Few techniques are worth a trial. What the lists of objects cost grows with the lights that reach an object and with
what is drawn and hidden again; a geometry buffer is paid once a pixel, and lists of clusters or tiles have the lights
that are near. So `forward` is tried against deferred shading by clusters and by tiles; every other technique was slower
than one of these wherever they were compared (docs/lighting-measured.md).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final

from renderer.frame import Frame, Needs, Pass
from renderer.scene import Camera, Scene
from renderer.techniques.deferred_cells import ClusteredDeferred, TiledDeferred
from renderer.techniques.forward import Forward
from renderer.techniques.technique import Technique
from renderer.visibility.trial import OnTrial, SpeedTrial
from rhi import Device

CANDIDATES: Final[dict[str, Callable[[], Technique]]] = {
    one.name: one for one in (Forward, ClusteredDeferred, TiledDeferred)
}
"""The techniques that `AutoTechnique` tries, in this order. Each is the fastest for some scene, view and device."""
FEW_LAMPS: Final = 32
"""The number of point and spot lights in view below which kernels that take seconds to build aren't built for a
trial."""

_SLOW_GROUPS: Final = ("llvmpipe", "softpipe")
"""In the names of devices that run a work-group with barriers thread by thread, for which `tiled_deferred` takes 8
times as long as `forward`."""
_SOME: Final = 16
"""Added to numbers of lights before they are compared, so that a few more aren't another view."""


class AutoTechnique(OnTrial):
    """Tries each candidate for some frames, then stays with the fastest until the view has changed (`SpeedTrial`).

    The candidates' pictures differ by at most 2 of 255 levels, so a trial isn't seen. A trial frame waits for the
    device. While the visibility algorithm is on trial itself, techniques aren't exchanged. Other than other techniques,
    an object serves one renderer only.

    Attributes:
        name: the name on the command line.
        because: why the technique in use was chosen.
    """

    name: Final = "auto"

    def __init__(
        self,
        scene: Scene,
        device: Device,
        makers: Mapping[str, Callable[[], Technique]] = CANDIDATES,
        *,
        frames: int = 5,
        rest: int = 120,
    ) -> None:
        """`makers` make the techniques to be tried, named as in `CANDIDATES`; `frames` and `rest` are those of a
        `SpeedTrial`."""
        self._techniques = {name: make() for name, make in makers.items()}
        self._scene = scene
        self._device = device
        self._timing = frames, rest
        self._size = (0, 0)
        self._trial = SpeedTrial(scene, list(self._techniques)[:1])
        self.because = "nothing is measured before the first frame"

    @property
    def current(self) -> Technique:
        """The technique that draws the next frame."""
        return self._techniques[self._trial.chosen]

    def declare(self, needs: Needs) -> Sequence[Pass[Frame]]:
        """Return the passes of the technique in use."""
        return self.current.declare(needs)

    def look(self, camera: Camera, size: tuple[int, int]) -> None:
        """Begin a trial if the view is another one. Call it before each frame."""
        if size != self._size:
            self._size = size
            self._trial.begin()
        self._trial.look(camera)

    def note(self, seconds: float | None, camera: Camera, needs: Needs) -> None:
        """Note what a frame needed, and the seconds that it took if it was a trial frame. Call it after each frame."""
        names, because = list_candidates(self._device, needs, self._techniques)
        if not set(names) <= set(self._trial.names):
            frames, rest = self._timing
            self._trial = SpeedTrial(self._scene, names, frames=frames, rest=rest)
        elif seconds is not None:
            self._trial.add_time(seconds, camera)
        elif not self._trial.is_trying:
            self._trial.rest(needs.lamps_in_view + _SOME)
        self.because = because if len(self._trial.names) == 1 else self._explain()

    def _explain(self) -> str:
        times = sorted(self._trial.times.items(), key=lambda one: one[1])
        if self.is_trying or not times:
            return f"{', '.join(self.names)} are being tried"
        (_, least), *others = times
        slower = ", ".join(f"{name} {1e3 * seconds:.1f}" for name, seconds in others)
        return f"the fastest in this view, {1e3 * least:.1f} ms a frame; {slower}"


def list_candidates(device: Device, needs: Needs, names: Iterable[str]) -> tuple[list[str], str]:
    """Return those of the techniques `names` that are worth a trial on a device in a frame with these needs, and why
    there is only the first one, if so."""
    first, *others = names
    lamps = needs.lamps_in_view
    can = device.capabilities
    if not can.renders:
        return [first], f"a {device.backend_name} device draws nothing that could be measured"
    if not can.compute:
        return [first], "the device has no compute shaders to list lights"
    if can.backend == "cl" and lamps < FEW_LAMPS:
        return [first], f"{lamps} lights in view, and on cl other techniques pay from some {FEW_LAMPS} on"
    if TiledDeferred.name in others and (not lamps or any(one in can.device for one in _SLOW_GROUPS)):
        others.remove(TiledDeferred.name)  # without lamps it is the same as by clusters
    return [first, *others], "the only candidate"
