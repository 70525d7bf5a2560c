"""The technique that measures others: which one is the fastest depends on the scene, the view and the device.

Few techniques are worth a trial. What the lists of objects cost grows with the lights that reach an object
and with what is drawn and hidden again; a geometry buffer is paid once a pixel, and lists of clusters or
tiles have the lights that are near. So `forward` is tried against deferred shading by clusters and by tiles;
every other technique was slower than one of these wherever they were compared (docs/measurements/lighting-measured.md).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final

from renderer.frame import Frame, FrameEffects, FramePass
from renderer.scene import Camera, Scene
from renderer.techniques.deferred_by_cells import ClusteredDeferred, TiledDeferred
from renderer.techniques.forward import Forward
from renderer.techniques.technique import Technique
from renderer.visibility.speed_trial import CandidateSelector, SpeedTrial
from rhi import Device

CANDIDATES: Final[dict[str, Callable[[], Technique]]] = {
    technique.name: technique for technique in (Forward, ClusteredDeferred, TiledDeferred)
}
"""The techniques that `AutoTechnique` tries, in this order. Each is the fastest for some scene, view and
device."""
MIN_TRIAL_LIGHTS: Final = 32
"""The number of point and spot lights in view below which kernels that take seconds to build aren't built for
a trial."""

_SLOW_GROUPS: Final = ("llvmpipe", "softpipe")
"""In the names of devices that run a work-group with barriers thread by thread, for which `tiled_deferred`
takes 8 times as long as `forward`."""
_LIGHT_MARGIN: Final = 16
"""Added to numbers of lights before they are compared, so that a few more don't start a trial."""


class AutoTechnique(CandidateSelector):
    """Tries each candidate for some frames, then stays with the fastest until the view has changed
    (`SpeedTrial`).

    The candidates' images differ by at most 2 of 255 levels, so a trial isn't seen. A trial frame waits for
    the device. While the visibility algorithm is on trial itself, techniques aren't exchanged. Other than
    other techniques, an object serves one renderer only.

    Attributes:
        name: the name on the command line.
        reason: why the technique in use was chosen.
    """

    name: Final = "auto"

    def __init__(
        self,
        scene: Scene,
        device: Device,
        factories: Mapping[str, Callable[[], Technique]] = CANDIDATES,
        *,
        frames: int = 5,
        idle: int = 120,
    ) -> None:
        """`factories` create the techniques to try, by their names in `CANDIDATES`; `frames` and `idle`
        are parameters of the `SpeedTrial`."""
        self._techniques = {name: make() for name, make in factories.items()}
        self._scene = scene
        self._device = device
        self._timing = frames, idle
        self._size = (0, 0)
        self._trial = SpeedTrial(scene, list(self._techniques)[:1])
        self.reason = "nothing is measured before the first frame"

    @property
    def current(self) -> Technique:
        """The technique that draws the next frame."""
        return self._techniques[self._trial.current_name]

    def declare(self, effects: FrameEffects) -> Sequence[FramePass[Frame]]:
        """The passes of the technique in use."""
        return self.current.declare(effects)

    def check_view(self, camera: Camera, size: tuple[int, int]) -> None:
        """Start a trial if the view has changed. Called before each frame."""
        if size != self._size:
            self._size = size
            self._trial.begin()
        self._trial.check_view(camera)

    def note(self, seconds: float | None, camera: Camera, effects: FrameEffects) -> None:
        """Record the effects of a frame, and its seconds if it was a trial frame. Called after each frame."""
        names, reason = list_candidates(self._device, effects, self._techniques)
        if not set(names) <= set(self._trial.names):
            frames, idle = self._timing
            self._trial = SpeedTrial(self._scene, names, frames=frames, idle=idle)
        elif seconds is not None:
            self._trial.add_time(seconds, camera)
        elif not self._trial.is_trying:
            self._trial.idle(effects.local_lights_in_view + _LIGHT_MARGIN)
        self.reason = reason if len(self._trial.names) == 1 else self._explain()

    def _explain(self) -> str:
        times = sorted(self._trial.times.items(), key=lambda item: item[1])
        if self.is_trying or not times:
            return f"{', '.join(self.names)} are being tried"
        (_, least), *others = times
        slower = ", ".join(f"{name} {1e3 * seconds:.1f}" for name, seconds in others)
        return f"the fastest in this view, {1e3 * least:.1f} ms a frame; {slower}"


def list_candidates(device: Device, effects: FrameEffects, names: Iterable[str]) -> tuple[list[str], str]:
    """The techniques of `names` that are worth a trial in a frame with these effects, and why there is
    only one, if there is."""
    first, *others = names
    light_count = effects.local_lights_in_view
    can = device.capabilities
    if not can.renders:
        return [first], f"a {device.backend_name} device draws nothing that could be measured"
    if not can.compute:
        return [first], "the device has no compute shaders to list lights"
    if can.backend == "cl" and light_count < MIN_TRIAL_LIGHTS:
        return [
            first
        ], f"{light_count} lights in view, and on cl other techniques pay from some {MIN_TRIAL_LIGHTS} on"
    if TiledDeferred.name in others and (not light_count or any(name in can.device for name in _SLOW_GROUPS)):
        others.remove(TiledDeferred.name)  # without local lights it is the same as by clusters
    return [first, *others], "the only candidate"
