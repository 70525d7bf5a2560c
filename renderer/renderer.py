"""The renderer: draws a scene frame by frame with a technique and a visibility algorithm.

A frame is planned from what it needs: the effects that its scene has and its view shows. The technique declares the
passes of these effects, and their plan is kept for as long as the effects are the same.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cached_property
from time import perf_counter
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.frame import (
    AS_GIVEN,
    EXACT_GLOW,
    Blending,
    Frame,
    GlowSettings,
    Layer,
    Needs,
    Plan,
    SceneLayer,
    SceneResources,
    SeenFeatures,
    Targets,
    TextureSettings,
    View,
    find_needs,
    make_plan,
)
from renderer.frame.images import SceneImages
from renderer.scene import Camera, Scene, Simulator
from renderer.scene.catching_up import count_steps
from renderer.scene.finite import check_finite
from renderer.shadows import ShadowMaps, shadow_passes
from renderer.stereo import EyePair, Stereo, fit_picture
from renderer.techniques import AutoTechnique, Forward, Technique
from renderer.techniques.inspection import Inspection
from renderer.techniques.parts.depth import bind_depth_programs
from renderer.techniques.parts.scaling import scale_image
from renderer.tessellation import Tessellator, tessellation_passes
from renderer.visibility import AutoCulling, VisibilityAlgorithm, VisibilityStatistics, make_visibility
from rhi import Device, Texture
from rhi.shading import Precision

_COUNTERS: Final = ("queries", "software_state_changes", "hardware_state_changes", "upload_bytes")
"""The device's counters that are part of a frame's statistics."""
ANIMATION_LAG: Final = 0.5
"""The pixels by which what is small on the screen may be late, unless one says otherwise."""


@dataclass(frozen=True, slots=True)
class FrameStatistics:
    """The cost of one frame, without its layers.

    Attributes:
        triangles: number of triangles of the objects drawn.
        draws: number of objects drawn; one call may draw many.
        queries: number of occlusion queries.
        software_state_changes, hardware_state_changes: states set by scopes, and values sent to the device; with
            layers these include setting back what the last frame's layers changed.
        upload_bytes: bytes written to the device.
        simulation_steps: steps taken by the simulations of drawn objects, counted for each member.
        skipped_simulations: number of simulated or animated objects that weren't drawn.
    """

    triangles: int
    draws: int
    queries: int
    software_state_changes: int
    hardware_state_changes: int
    upload_bytes: int
    simulation_steps: int
    skipped_simulations: int


@dataclass(frozen=True, eq=False)
class FrameResult:
    """A submitted frame.

    `image`, `depth` and all other contents of the frame, `targets`, are overwritten by the next frame. All but `image`
    have the size at which the frame was drawn (`Renderer.scale`). `visibility` is
    the cost of finding the visible objects, None if the technique didn't do so. Where the device decides what is drawn,
    the first use of `visible` or `statistics` waits for the device; they can be read until the next frame.

    With two eyes, `image` shows both, and `pictures` and `frames` are the left and the right one's; `depth`, `targets`
    and `visibility` are the left one's, and `statistics` are those of both together.
    """

    image: Texture
    depth: Texture
    targets: Targets
    visibility: VisibilityStatistics | None
    frames: tuple[Frame, ...]
    _counters: dict[str, int]

    @property
    def pictures(self) -> tuple[Texture, ...]:
        """The picture of each eye."""
        return tuple(frame.targets.image for frame in self.frames)

    @property
    def visible(self) -> NDArray[np.int64]:
        """The rows of the objects drawn, with two eyes ascending."""
        rows = [frame.drawn.rows for frame in self.frames]
        return rows[0] if len(rows) == 1 else np.unique(np.concatenate(rows))

    @cached_property
    def statistics(self) -> FrameStatistics:
        """The cost of the frame."""
        drawn = [frame.drawn for frame in self.frames]
        triangles = sum(one.triangles for one in drawn)
        draws = sum(len(one.rows) for one in drawn)
        return FrameStatistics(triangles=triangles, draws=draws, **self._counters)


class Renderer:
    """Draws one scene on one device.

    The attributes `technique`, `visibility`, `blending`, `precision` and `glow` may be exchanged between any two
    frames, and `layers` changed, which are drawn over each frame in their order, those that belong to the scene first.
    With `simulates_unseen`, by default off, what an absence would change, such as cloth, is simulated in every frame.
    `show` ends a frame with its image: by default it is `Device.present`; a window puts its own in that place.
    """

    def __init__(
        self,
        device: Device,
        scene: Scene,
        *,
        technique: Technique | None = None,
        visibility: VisibilityAlgorithm | str = "auto",
        size: tuple[int, int] = (960, 540),
        blending: Blending = Blending.SORTED,
        precision: Precision = Precision.FAST,
        textures: TextureSettings = AS_GIVEN,
        glow: GlowSettings = EXACT_GLOW,
        validation: bool = False,
    ) -> None:
        """Create the targets and upload the scene.

        Args:
            technique: how the scene is drawn; forward shading by default. `AutoTechnique` measures which one is the
                fastest; its picture may change by 2 of 255 levels when it changes its mind.
            visibility: an algorithm made for `scene`, or the name of one; `auto` measures which one is the fastest.
            size: (width, height) of the image in pixels.
            blending: how transparent surfaces that cover each other are put together.
            precision: that of the techniques' shaders; with FAST, of those that don't ask for EXACT themselves.
            textures: how well the scene's textures are read.
            glow: how exactly glow is made.
            validation: whether to check samples of what is simulated: each batch has one object whose vertices must be
                inside its bounds (`scene-left-bounds`).
        """
        self.device = device
        self.scene = scene
        self.technique: Technique = technique or Forward()
        self.blending = blending
        self.precision = precision
        self.glow = glow
        self._animation_step, self._animation_lag = 0.0, ANIMATION_LAG
        self.simulates_unseen = False
        self.layers: list[Layer] = []
        self.show: Callable[[Texture], None] = device.present
        self._own: list[VisibilityAlgorithm] = []
        if isinstance(visibility, str):
            visibility = make_visibility(visibility, scene, device)
            self._own.append(visibility)
        self._plans: dict[tuple[object, ...], Plan[Frame]] = {}
        self._seen = SeenFeatures(scene)
        self._needs: Needs | None = None  # of the last frame
        self._planned: Technique | None = None
        self._drawn: Plan[Frame] | None = None  # the plan of the last frame
        self._size, self._scale = size, 1.0
        self._pair: EyePair | None = None
        with ExitStack() as made:
            self._targets = Targets(device, size)
            made.callback(self._targets.destroy)
            self._view = View(device, "eye", visibility)
            made.callback(self._view.destroy)
            self._resources = SceneResources(device, scene, textures)
            self._validation = self.simulator.validation = validation
            made.pop_all()

    @property
    def animation_step(self) -> float:
        """The seconds after which what moves by itself moves on, 0 for every frame. It may be exchanged between any two
        frames.

        In the frames between, simulations, transforms and the shadows of what moves stay as they are.
        """
        return self._animation_step

    @animation_step.setter
    def animation_step(self, seconds: float) -> None:
        rules.check_amount(rules.BAD_STEP, "Renderer.animation_step = …", seconds)
        self._animation_step = seconds

    @property
    def animation_lag(self) -> float:
        """The pixels by which what is small on the screen may be late, 0 for nothing. It may be exchanged between any
        two frames.

        What would move by less than that in some frames, at `SPEED` of its diameters a second, moves on only then. What
        is no larger rests. Animations without bounds move on in every frame.
        """
        return self._animation_lag

    @animation_lag.setter
    def animation_lag(self, pixels: float) -> None:
        rules.check_amount(rules.BAD_LAG, "Renderer.animation_lag = …", pixels)
        self._animation_lag = pixels

    @property
    def light_cutoff(self) -> float:
        """The light of a lamp that is too faint to matter, 0 for none. It may be exchanged between any two frames.

        Lamps end where less of their light arrives; 1 is what a directional light of intensity 1 gives. So fewer lamps
        reach a surface, and up to 1.1 times as much of each is missing.
        """
        return self._resources.light_cutoff

    @light_cutoff.setter
    def light_cutoff(self, least: float) -> None:
        rules.check_amount(rules.BAD_CUTOFF, "Renderer.light_cutoff = …", least)
        self._resources.light_cutoff = least

    @property
    def view(self) -> View:
        """The view that the image is drawn from, with what techniques keep for it; with two eyes the left one."""
        return self._view

    @property
    def visibility(self) -> VisibilityAlgorithm:
        """The algorithm that finds the objects in the image."""
        return self._view.visibility

    @visibility.setter
    def visibility(self, visibility: VisibilityAlgorithm) -> None:
        self._view.visibility = visibility

    @property
    def size(self) -> tuple[int, int]:
        """The (width, height) of the image in pixels; setting it creates new targets."""
        return self._size

    @size.setter
    def size(self, size: tuple[int, int]) -> None:
        if size != self._size:
            self._resize(size, self.stereo, self._scale)

    @property
    def scale(self) -> float:
        """The size at which frames are drawn, in that of the image: 0.1 to 2. It may be exchanged between any two
        frames. Layers are drawn at the image's size, unless they are a `SceneLayer`."""
        return self._scale

    @scale.setter
    def scale(self, scale: float) -> None:
        rules.check_scale("Renderer.scale = …", scale)
        if scale != self._scale:
            self._resize(self._size, self.stereo, scale)

    @property
    def stereo(self) -> Stereo | None:
        """The settings of two eyes, None for one. It may be exchanged between any two frames."""
        return None if self._pair is None else self._pair.stereo

    @stereo.setter
    def stereo(self, stereo: Stereo | None) -> None:
        pair, size = self._pair, self._size
        if pair is None or stereo is None or fit_picture(stereo.output, size) != fit_picture(pair.stereo.output, size):
            self._resize(size, stereo, self._scale)
        else:
            pair.stereo = stereo

    def _resize(self, size: tuple[int, int], stereo: Stereo | None, scale: float) -> None:
        """Create what is needed for images of `size` with one eye or two. If it can't be, all stays as it was."""
        pair = None if stereo is None else EyePair(self.device, stereo, size, self._view, scale)
        try:
            self._targets.resize(size if stereo is None else fit_picture(stereo.output, size), scale)
        except BaseException:
            if pair is not None:
                pair.destroy()
            raise
        if self._pair is not None:
            self._pair.destroy()
        self._size, self._pair, self._scale = size, pair, scale

    @property
    def shadows(self) -> ShadowMaps:
        """The shadow maps, of lights that cast shadows."""
        return self._resources.workspace(ShadowMaps)

    @property
    def tessellator(self) -> Tessellator:
        """The tessellator of height fields; its `settings` may be exchanged between any two frames."""
        return self._resources.workspace(Tessellator)

    @property
    def resources(self) -> SceneResources:
        """The scene on the device."""
        return self._resources

    @property
    def images(self) -> SceneImages | None:
        """The scene's images on the device; None if no material reads any."""
        return self._resources.images

    @property
    def image_bytes(self) -> int:
        """The memory of the scene's images on the device, with their mip levels."""
        return 0 if self.images is None else self.images.bytes

    @property
    def simulator(self) -> Simulator:
        """Runs the simulations of what is drawn.

        It may be exchanged for another one of the same scene (`Scene.make_simulator`), whose members may have taken
        other steps.
        """
        return self._resources.simulator

    @simulator.setter
    def simulator(self, simulator: Simulator) -> None:
        simulator.validation = self._validation
        self._resources.simulator = simulator

    def render(self, camera: Camera, seconds: float = 0.0) -> FrameResult:
        """Draw the scene at the time `seconds` as `camera` sees it, with the image's aspect. Doesn't wait for the
        GPU, unless something `is_trying`."""
        auto = self.technique
        if not isinstance(auto, AutoTechnique):
            return self._draw(camera, seconds)[0]
        auto.look(camera, self.size)
        is_timed = auto.is_trying and not self._is_trying_visibility
        if is_timed:
            self.device.finish()
        began = perf_counter()
        result, needs = self._draw(camera, seconds)
        if is_timed:
            self.device.finish()
        is_timed = is_timed and not self._is_trying_visibility  # which may have begun to
        auto.note(perf_counter() - began if is_timed else None, camera, needs)
        return result

    @property
    def is_trying(self) -> bool:
        """Whether the next frame is on trial: the visibility algorithm or the technique measures which of several is
        the fastest."""
        technique = self.technique
        return self._is_trying_visibility or (isinstance(technique, AutoTechnique) and technique.is_trying)

    @property
    def _is_trying_visibility(self) -> bool:
        return isinstance(self.visibility, AutoCulling) and self.visibility.is_trying

    def _draw(self, camera: Camera, seconds: float) -> tuple[FrameResult, Needs]:
        """Draw a frame; return it and what it needed."""
        device, resources, pair = self.device, self._resources, self._pair
        before = device.statistics
        check_finite("render", seconds=seconds, position=camera.position, rotation=camera.rotation)
        self.scene.check_numbers("render")
        around = self._aim(camera)
        if self._animation_step:
            seconds = count_steps(seconds, self._animation_step) * self._animation_step
        self.scene.seconds = seconds
        expected = self.simulator.drawn
        self.simulator.begin_frame(seconds)
        self.scene.refresh()
        self.simulator.slow_down(around, self._targets.size[1], self._animation_lag)
        eyes = [self._view] if pair is None or pair.stereo.is_reprojected else [self._view, pair.view]
        resources.update(*(eye.camera for eye in eyes), views=[eye.buffer for eye in eyes])
        resources.hidden.begin_frame(None if self.simulates_unseen or pair is not None else around)
        resources.expect(around, expected, self.simulator.diverging if self.simulates_unseen else None)
        needs = self._find_needs(around, self._seen.settle(around))
        plan = self._plan(needs)
        if plan is not self._drawn:
            self._drawn = plan
            if not needs.casts_shadows:
                resources.release(ShadowMaps)
        left = Frame(device, self._view, resources, self._targets, needs, precision=self.precision)
        frames = [left]
        self._run(plan, left)
        if left.statistics is not None:
            left.drawn.note_hidden()
        if pair is not None:
            right = Frame(device, pair.view, resources, pair.targets, needs, left, self.precision)
            frames.append(right)
            moved = pair.plan(has_layers=bool(self.layers))
            if moved is None:
                resources.look_from(1)
                left.drawn.fetch_lists()  # the right eye makes others
            with device.event(pair.view.name):
                self._run(moved or plan, right)
        after = device.statistics
        for frame in frames:
            inside: list[Layer] = [layer for layer in self.layers if isinstance(layer, SceneLayer)]
            for layer in inside:
                layer.render(device, frame)
            scale_image(frame)
            for layer in self.layers:
                if layer not in inside:
                    layer.render(device, frame)
        image = left.targets.image
        if pair is not None:
            with device.event("both eyes"):
                image = pair.show(*frames)
        self.show(image)
        counters = {name: getattr(after, name) - getattr(before, name) for name in _COUNTERS}
        counters["simulation_steps"] = self.simulator.steps
        counters["skipped_simulations"] = len(self.simulator) - self.simulator.seen
        result = FrameResult(image, left.targets.depth, left.targets, left.statistics, tuple(frames), counters)
        return result, needs

    def _aim(self, camera: Camera) -> Camera:
        """Aim the views of a frame through `camera`; return a camera that sees all that they see."""
        camera = self._fit(camera)
        if self._pair is None:
            self._view.aim(camera)
            return camera
        rig, right = self._pair.stereo.rig, self._pair.view
        around = rig.enclose(camera)
        right.visibility = self._view.visibility
        for view, eye in zip((self._view, right), rig.place_eyes(camera), strict=True):
            view.aim(eye, around)
        return around

    def _fit(self, camera: Camera) -> Camera:
        width, height = self._size
        return camera.with_aspect(width / height)

    def _run(self, plan: Plan[Frame], frame: Frame) -> None:
        """Run the passes of a plan."""
        frame.targets.provide(plan.textures)
        for one in plan.passes:
            with self.device.event(one.name):
                one.run(frame)

    def plan(self, camera: Camera) -> tuple[Needs, Plan[Frame]]:
        """Return what a frame of `camera` needs, and its plan; nothing is drawn."""
        camera = self._fit(camera)
        if self._pair is not None:
            camera = self._pair.stereo.rig.enclose(camera)
        needs = self._find_needs(camera)
        return needs, self._plan(needs)

    def _find_needs(self, camera: Camera, seen: frozenset[str] | None = None) -> Needs:
        resources = self._resources
        self._needs = find_needs(
            self.scene, camera, reaches=resources.reaching, blending=self.blending, glow=self.glow, seen=seen,
            lights=resources.lights, last=self._needs,
        )  # fmt: skip
        return self._needs

    def _plan(self, needs: Needs) -> Plan[Frame]:
        """Return the plan of a frame with these needs; it is made once."""
        technique = self.technique
        if isinstance(technique, AutoTechnique):
            technique = technique.current
        if self._planned is not technique:
            self._plans.clear()
            self._planned = technique
        plan = self._plans.get(needs.key)
        if plan is None:
            is_lit = not isinstance(technique, Inspection) or technique.is_lit
            before = [*tessellation_passes(needs), *(shadow_passes(needs, bind_depth_programs) if is_lit else ())]
            plan = self._plans[needs.key] = make_plan([*before, *technique.declare(needs)])
        return plan

    def destroy(self) -> None:
        """Destroy all resources on the device, except those of layers and of a visibility algorithm that was passed
        in."""
        for visibility in self._own:
            visibility.destroy()
        self._own.clear()
        if self._pair is not None:
            self._pair.destroy()
        self._targets.destroy()
        self._view.destroy()
        self._resources.destroy()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.destroy()
