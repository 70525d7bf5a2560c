"""The renderer: draws a scene frame by frame with a technique and a visibility algorithm.

A frame is planned from what it needs: the effects that its scene has and its view shows. The technique
declares the passes of these effects, and their plan is kept for as long as the effects are the same.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from time import perf_counter
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.frame import (
    DEFAULT_ENVIRONMENT,
    DEFAULT_FOCUS,
    DEFAULT_OCCLUSION,
    EXACT_BLOOM,
    NO_HISTORY,
    SAMPLER_DEFAULTS,
    Blending,
    BloomSettings,
    DepthOfFieldSettings,
    EnvironmentMaps,
    EnvironmentSettings,
    Frame,
    FrameEffects,
    Layer,
    LightComponent,
    LightWatch,
    OcclusionSettings,
    Plan,
    SceneLayer,
    SceneResources,
    ScreenLayer,
    Targets,
    TemporalSettings,
    TextureSettings,
    UploadSettings,
    View,
    VisibleFeatures,
    are_effects_same,
    collect_frame_effects,
    last_version,
    make_plan,
    watch_lights,
)
from renderer.frame.attributes import CheckedAttribute, TypedAttribute
from renderer.frame.lobe_fits import LobeTable
from renderer.frame.motion import SceneMotion
from renderer.frame.scene_images import SceneImages
from renderer.frame.temporal import STILL_AFTER, TemporalHistory, compute_offset, shift_samples
from renderer.frame.uploads import SceneUploads, check_uploads
from renderer.scene import Camera, Perspective, Projection, Scene, Simulator
from renderer.scene.catch_up import count_steps
from renderer.scene.finite import LONGEST_TIME, check_finite, check_time
from renderer.shadows import ShadowFilter, ShadowMaps, shadow_passes
from renderer.stereo import EyePair, Stereo, eye_image_size
from renderer.techniques import AutoTechnique, Technique, to_technique
from renderer.techniques.inspection import Inspection
from renderer.techniques.parts.ambient_occlusion import occlusion_passes
from renderer.techniques.parts.contact_shadows import contact_passes
from renderer.techniques.parts.depth import bind_depth_programs
from renderer.techniques.parts.environment import environment_passes
from renderer.techniques.parts.repeated_frame import RepeatedDraw, repeat_frame
from renderer.techniques.parts.scaling import scale_image
from renderer.techniques.parts.temporal import temporal_passes
from renderer.tessellation import Tessellator, tessellation_passes
from renderer.visibility import AutoCulling, VisibilityAlgorithm, VisibilityStatistics, to_visibility
from renderer.visibility.detail import DetailLimit
from rhi import Device, Format, Statistics, Texture
from rhi.math import is_parallel
from rhi.shading import Precision


@dataclass(eq=False, slots=True)
class _SteadyFrame:
    """The part of a frame that the next one shares, if only the camera moves.

    Attributes:
        settings: those of the renderer.
        projection: that of the camera.
        effects: those of the frame.
        plan: the plan of these effects.
        values: the `Frame.values`.
        watch: tells whether a frame has the same effects; None if the effects must be collected for that.
        events: a label for each pass of the plan.
        repeat: a function that draws the frames after the second one; None if there is none.
        is_repeated: whether that was sought.
    """

    settings: tuple[object, ...]
    projection: Projection
    effects: FrameEffects
    plan: Plan[Frame]
    values: dict[object, Any]
    watch: LightWatch | None
    events: Sequence[AbstractContextManager[None]]
    repeat: RepeatedDraw | None = None
    is_repeated: bool = False


_LONGEST_PAUSE: Final = 0.5
"""The seconds between two frames from which on temporal anti-aliasing begins anew."""
ANIMATION_LAG: Final = 0.5
"""The lag allowed for small objects, in pixels, unless one says otherwise."""
DETAIL_ERROR: Final = 1.0
"""The largest error of levels of detail, in pixels, unless one says otherwise."""


@dataclass(frozen=True, slots=True)
class FrameStatistics:
    """The cost of one frame, without its layers.

    Attributes:
        triangles: number of triangles of the objects drawn.
        draws: number of objects drawn; one call may draw many.
        queries: number of occlusion queries.
        software_state_changes, hardware_state_changes: states set by scopes, and values sent to the device;
            with layers these include setting back what the last frame's layers changed.
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

    `image`, `depth` and all other contents of the frame, `targets`, are overwritten by the next frame. All
    but `image` have the size at which the frame was drawn (`Renderer.scale`). `visibility` is the cost of
    finding the visible objects, None if the technique didn't do so. Where the device decides what is drawn,
    the first use of `visible` or `statistics` waits for the device; they can be read until the next frame.

    With two eyes, `image` shows both, and `eye_images` and `frames` are the left and the right one's, without any
    `ScreenLayer`;
    `depth`, `targets` and `visibility` are the left one's, and `statistics` are those of both together. If the eyes
    take turns, there is one, and `eye` is the index of the eye that the frame is shown to: 0 is the left one.
    """

    image: Texture
    depth: Texture
    targets: Targets
    visibility: VisibilityStatistics | None
    frames: tuple[Frame, ...]
    _counters: dict[str, int]
    eye: int | None = None

    @property
    def eye_images(self) -> tuple[Texture, ...]:
        """The image of each eye."""
        return tuple(frame.targets.image for frame in self.frames)

    @property
    def visible(self) -> NDArray[np.int64]:
        """The indices of the objects drawn; with two eyes, ascending."""
        rows = [frame.draw_result.object_indices for frame in self.frames]
        return rows[0] if len(rows) == 1 else np.unique(np.concatenate(rows))

    @cached_property
    def statistics(self) -> FrameStatistics:
        """The cost of the frame."""
        results = [frame.draw_result for frame in self.frames]
        triangles, draws = results[0].triangles, len(results[0].object_indices)
        for right in results[1:]:
            objects, more = right.count_for_right()
            triangles, draws = triangles + more, draws + objects
        return FrameStatistics(triangles=triangles, draws=draws, **self._counters)


def _to_technique(renderer: Any, call: str, value: Technique | str | None) -> Technique:
    return to_technique(call, value, renderer.scene, renderer.device)


class Renderer:
    """Draws one scene on one device.

    The attributes `technique`, `visibility`, `blending`, `precision`, `bloom`, `occlusion`, `depth_of_field`,
    `temporal`, `environment` and `light_component` may be exchanged between any two frames, and `layers` changed,
    which are drawn over each frame in their order: first each `SceneLayer`, last each `ScreenLayer`. With
    `simulates_hidden`, by default off, what an absence would change, such as cloth, is simulated in every frame.
    `show` ends a frame with its image: by default it is `Device.present`; a window puts its own in that place.

    `technique` and `visibility` may be set to a name. What isn't of an attribute's type is refused as
    `renderer-attribute`.
    """

    technique = CheckedAttribute[Technique, Technique | str | None](_to_technique)
    blending = TypedAttribute(Blending)
    precision = TypedAttribute(Precision)
    bloom = TypedAttribute(BloomSettings)
    occlusion = TypedAttribute(OcclusionSettings)
    depth_of_field = TypedAttribute(DepthOfFieldSettings)
    temporal = TypedAttribute(TemporalSettings)
    environment = TypedAttribute(EnvironmentSettings)
    light_component = TypedAttribute(LightComponent)

    def __init__(
        self,
        device: Device,
        scene: Scene,
        *,
        technique: Technique | str | None = None,
        visibility: VisibilityAlgorithm | str = "auto",
        size: tuple[int, int] = (960, 540),
        blending: Blending = Blending.SORTED,
        precision: Precision = Precision.FAST,
        textures: TextureSettings = SAMPLER_DEFAULTS,
        bloom: BloomSettings = EXACT_BLOOM,
        occlusion: OcclusionSettings = DEFAULT_OCCLUSION,
        depth_of_field: DepthOfFieldSettings = DEFAULT_FOCUS,
        temporal: TemporalSettings = NO_HISTORY,
        environment: EnvironmentSettings = DEFAULT_ENVIRONMENT,
        light_component: LightComponent = LightComponent.ALL,
        uploads: UploadSettings | None = None,
        validation: bool = False,
    ) -> None:
        """Create the targets and upload the scene.

        Args:
            technique: how the scene is drawn, or the name of a technique; forward shading by default. `auto`
                measures which one is the fastest; its image may change by 2 of 255 levels when it changes its
                mind.
            visibility: an algorithm made for `scene`, or the name of one; `auto` measures which one is the
                fastest.
            size: (width, height) of the image in pixels.
            blending: how transparent surfaces that cover each other are put together.
            precision: that of the techniques' shaders; with FAST, of those that don't ask for EXACT
                themselves.
            textures: how well the scene's textures are read.
            bloom: how exactly bloom is computed.
            occlusion: how exactly ambient occlusion is computed.
            depth_of_field: how exactly depth of field is computed.
            temporal: how samples of many frames are put together, which smooths edges (temporal anti-aliasing).
            environment: how exactly light from an environment is computed.
            light_component: the part of the light that is drawn.
            uploads: how many bytes of the scene each frame uploads; None uploads all of them now.
            validation: whether to check samples of what is simulated: each batch has one object whose
                vertices must be inside its bounds (`scene-left-bounds`)."""
        self.device = rules.check_type("Renderer(device)", device, Device)
        self.scene = rules.check_type("Renderer(scene)", scene, Scene)
        self.technique = technique
        self.blending = blending
        self.precision = precision
        self.bloom = bloom
        self.occlusion = occlusion
        self.depth_of_field = depth_of_field
        self.temporal = temporal
        self._sample_index = 0  # of the frame's offset
        self._still_state: tuple[object, ...] = ()  # of the last frame
        self._still_frames = 0  # how many in a row had that state
        self._forgets_history = False
        self._last_seconds = 0.0
        self.environment = environment
        self.light_component = light_component
        self._animation_step, self._animation_lag = 0.0, ANIMATION_LAG
        self.simulates_hidden = False
        self.layers: list[Layer] = []
        self.show: Callable[[Texture], None] = device.present
        self._named_algorithms: dict[str, VisibilityAlgorithm] = {}
        rules.check_type("Renderer(textures=...)", textures, TextureSettings)
        check_uploads(uploads)
        self._plans: dict[tuple[object, ...], Plan[Frame]] = {}
        self._recent_features = VisibleFeatures(scene)
        self._effects: FrameEffects | None = None  # of the last frame
        blends_singles = not {Format.RGBA32F, Format.R32F} & device.capabilities.unblendable_formats
        self._widest_blended = Format.RGBA32F if blends_singles else Format.RGBA16F
        self._planned_technique: Technique | None = None
        self._last_plan: Plan[Frame] | None = None  # the plan of the last frame
        self._steady: _SteadyFrame | None = None  # None if the last frame has nothing that can be kept
        self._snapshot: tuple[object, ...] | None = None  # of the scene, when the last frame began
        self._size, self._scale = size, 1.0
        projection: Projection = Perspective()
        self._fitted = (
            (0, 0),
            projection,
            projection,
        )  # the last size and projection, and that with the aspect
        self._pair: EyePair | None = None
        with ExitStack() as stack:
            self._targets = Targets(device, size)
            stack.callback(self._targets.destroy)
            stack.callback(self._destroy_algorithms)
            self._view = View(device, "eye", self._to_visibility("Renderer(visibility=...)", visibility))
            stack.callback(self._view.destroy)
            self._last_view = self._view
            self._resources = SceneResources(device, scene, textures, uploads)
            self._resources.detail_error = DETAIL_ERROR
            images = self._resources.images
            self._has_stream = images is not None and images.stream is not None
            self._validation = self.simulator.validation = validation
            stack.pop_all()

    @property
    def animation_step(self) -> float:
        """The interval in seconds at which animations advance; 0 advances them in every frame. It may be
        exchanged between any two frames.

        In the frames between, simulations, transforms and the shadows of what moves stay as they are.
        """
        return self._animation_step

    @animation_step.setter
    def animation_step(self, seconds: float) -> None:
        rules.check_non_negative(rules.BAD_STEP, "Renderer.animation_step = …", seconds)
        self._animation_step = seconds

    @property
    def animation_lag(self) -> float:
        """The lag in pixels that the animation of small objects may have; 0 allows no lag. It may be
        exchanged between any two frames.

        What would move by less than that in some frames, at `MAX_EXPECTED_SPEED` of its diameters a second,
        moves on only then. What is no larger rests. Animations without bounds move on in every frame.
        """
        return self._animation_lag

    @animation_lag.setter
    def animation_lag(self, pixels: float) -> None:
        rules.check_non_negative(rules.BAD_LAG, "Renderer.animation_lag = …", pixels)
        self._animation_lag = pixels

    @property
    def light_cutoff(self) -> float:
        """Irradiance below which a local light is cut off; 0 cuts none. It may be exchanged between any two
        frames.

        Local lights end where less of their light arrives; 1 is what a directional light of intensity 1
        gives. So fewer local lights reach a surface, and up to 1.1 times as much of each is missing."""
        return self._resources.light_cutoff

    @light_cutoff.setter
    def light_cutoff(self, cutoff: float) -> None:
        rules.check_non_negative(rules.BAD_CUTOFF, "Renderer.light_cutoff = …", cutoff)
        self._resources.light_cutoff, self._steady = cutoff, None

    @property
    def detail_error(self) -> float:
        """The largest error of levels of detail, in pixels of the image and in texels of shadow maps; 0 draws all
        meshes in full. It may be exchanged between any two frames.

        Meshes with levels (`SceneBuilder.add_mesh`) are drawn as the coarsest one that is nowhere farther from the
        full mesh than that. What the device lists (`two_pass`, `depth_pyramid`) is drawn in full."""
        return self._resources.detail_error

    @detail_error.setter
    def detail_error(self, pixels: float) -> None:
        rules.check_non_negative(rules.BAD_DETAIL, "Renderer.detail_error = …", pixels)
        self._resources.detail_error, self._steady = pixels, None

    @property
    def view(self) -> View:
        """The view that the image is drawn from, with what techniques keep for it; with two eyes the left
        one."""
        return self._view

    @property
    def visibility(self) -> VisibilityAlgorithm:
        """The algorithm that finds the objects in the image. It may be set to the name of one."""
        return self._view.visibility

    @visibility.setter
    def visibility(self, visibility: VisibilityAlgorithm | str) -> None:
        self._view.visibility = self._to_visibility("Renderer.visibility = …", visibility)

    def _to_visibility(self, call: str, visibility: VisibilityAlgorithm | str) -> VisibilityAlgorithm:
        """The algorithm; one that is named is created once, and destroyed with the renderer."""
        if not isinstance(visibility, str):
            return to_visibility(call, visibility, self.scene, self.device)
        if visibility not in self._named_algorithms:
            self._named_algorithms[visibility] = to_visibility(call, visibility, self.scene, self.device)
        return self._named_algorithms[visibility]

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
        """The size at which frames are drawn, in that of the image: 0.1 to 2. It may be exchanged between any
        two frames. Layers are drawn at the image's size, unless they are a `SceneLayer`."""
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
        if stereo is not None:
            rules.check_type("Renderer.stereo = …", stereo, Stereo)
        pair, size = self._pair, self._size
        if (
            pair is None
            or stereo is None
            or eye_image_size(stereo.output, size) != eye_image_size(pair.stereo.output, size)
        ):
            self._resize(size, stereo, self._scale)
        else:
            pair.stereo = stereo

    def _resize(self, size: tuple[int, int], stereo: Stereo | None, scale: float) -> None:
        """Create what is needed for images of `size` with one eye or two. If it can't be, all stays as it
        was."""
        pair = None if stereo is None else EyePair(self.device, stereo, size, self._view, scale)
        try:
            self._targets.resize(size if stereo is None else eye_image_size(stereo.output, size), scale)
        except BaseException:
            if pair is not None:
                pair.destroy()
            raise
        if self._pair is not None:
            self._pair.destroy()
        self._size, self._pair, self._scale, self._steady = size, pair, scale, None
        self._last_view, self._view.far = self._view, None

    @property
    def shadows(self) -> ShadowMaps:
        """The shadow maps, of lights that cast shadows."""
        return self._resources.workspace(ShadowMaps)

    @property
    def tessellator(self) -> Tessellator:
        """The tessellator of surfaces; its `settings` may be exchanged between any two frames."""
        return self._resources.workspace(Tessellator)

    @property
    def resources(self) -> SceneResources:
        """The scene on the device."""
        return self._resources

    @property
    def uploads(self) -> SceneUploads | None:
        """The uploads of the scene over its frames: their progress and settings; None if all was uploaded at once."""
        return self._resources.uploads

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

        It may be exchanged for another one of the same scene (`Scene.make_simulator`), whose members may have
        taken other steps.
        """
        return self._resources.simulator

    @simulator.setter
    def simulator(self, simulator: Simulator) -> None:
        simulator.validation = self._validation
        self._resources.simulator = simulator

    def render(self, camera: Camera, seconds: float = 0.0) -> FrameResult:
        """Draw the scene at the time `seconds` as `camera` sees it, with the image's aspect. Doesn't wait for
        the GPU, unless something `is_trying`."""
        auto = self.technique
        if self.uploads is not None and not self.uploads.is_done:
            self.uploads.advance(self._fit(camera))
        if self._has_stream and self._reads_other_images(camera):
            self._steady = None
        if not isinstance(auto, AutoTechnique):
            return self._draw(camera, seconds)[0]
        auto.check_view(camera, self.size)
        is_timed = auto.is_trying and not self._is_trying_visibility
        if is_timed:
            self.device.finish()
        began = perf_counter()
        result, effects = self._draw(camera, seconds)
        if is_timed:
            self.device.finish()
        is_timed = is_timed and not self._is_trying_visibility  # which may have begun to
        auto.note(perf_counter() - began if is_timed else None, camera, effects)
        return result

    def _reads_other_images(self, camera: Camera) -> bool:
        """Return whether a frame needs other levels of streamed images than the last one."""
        images = self._resources.images
        if images is None or images.stream is None:
            return False
        return images.stream.needs_work(self._place_cameras(self._fit(camera)), self._targets.size)

    def _place_cameras(self, camera: Camera) -> Sequence[Camera]:
        """The cameras of all eyes, where a frame's camera is this one."""
        return [camera] if self._pair is None else self._pair.fit_rig(camera).place_eyes(camera)

    @property
    def is_trying(self) -> bool:
        """True if the next frame is on trial: the visibility algorithm or the technique measures which of
        several is the fastest."""
        technique = self.technique
        return self._is_trying_visibility or (isinstance(technique, AutoTechnique) and technique.is_trying)

    @property
    def _is_trying_visibility(self) -> bool:
        return isinstance(self.visibility, AutoCulling) and self.visibility.is_trying

    def _draw(self, camera: Camera, seconds: float) -> tuple[FrameResult, FrameEffects]:
        """Draw a frame; return it and its effects."""
        device, resources, pair = self.device, self._resources, self._pair
        if camera.__class__ is not Camera:
            rules.check_type("Renderer.render(camera)", camera, Camera)
        if not isfinite(sum(camera.position.tolist(), sum(camera.rotation.ravel().tolist()))):
            # one number that isn't finite makes all of it so
            check_finite("render", position=camera.position, rotation=camera.rotation)
        if seconds.__class__ is not float or not -LONGEST_TIME <= seconds <= LONGEST_TIME:
            check_time("render", seconds)
        last = self._steady
        if last is not None and last.repeat is not None and (result := self._repeat(last, camera, seconds)):
            return result, last.effects
        before = device.statistics
        steady = self._begin_steady(camera, seconds) or self._begin(camera, seconds)
        effects, plan, values = steady.effects, steady.plan, steady.values
        eyes = self._list_eyes()
        view, targets = eyes[0]
        left = Frame(
            device,
            view,
            resources,
            targets,
            effects,
            precision=self.precision,
            values=values,
        )
        has_late_layers = not effects.temporal.is_on or (pair is not None and pair.stereo.is_reprojected)
        if not has_late_layers:
            left.scene_layers = [layer.render for layer in self.layers if isinstance(layer, SceneLayer)]
        frames = [left]
        if pair is not None:
            pair.share_far(view, targets, plan, effects)
        self._run(plan, left, steady.events)
        if steady is last and not steady.is_repeated:  # the first that follows a full frame
            self._prepare_repeat(steady)
        if resources.may_simulate and resources.hidden.is_tracking and left.statistics is not None:
            left.draw_result.record_hidden()
        takes_turns = pair is not None and pair.stereo.takes_turns
        if pair is not None and not takes_turns:
            frames.append(self._draw_right(pair, left, plan))
        after = device.statistics
        screen_layers: list[ScreenLayer] = []
        if self.layers or targets.output_image is not None:
            for frame in frames:
                self._draw_layers(frame, has_late_layers)
            screen_layers = [layer for layer in self.layers if isinstance(layer, ScreenLayer)]
        image = left.targets.image
        if pair is not None and not takes_turns:
            with device.event("both eyes"):
                image = pair.show(left, frames[1], screen_layers)
        else:
            for layer in screen_layers:
                layer.render(device, left)
        self.show(image)
        turn = None
        if pair is not None and takes_turns:
            turn, pair.turn = pair.turn, 1 - pair.turn
        return self._finish(before, after, image, frames, turn), effects

    def _draw_right(self, pair: EyePair, left: Frame, plan: Plan[Frame]) -> Frame:
        """Draw the frame of the right eye."""
        right = Frame(
            self.device, pair.view, self._resources, pair.targets, left.effects, left, self.precision
        )
        right.scene_layers = left.scene_layers
        if pair.view.far is not None and not pair.view.far.are_copied:
            pair.view.far = None
        moved = pair.plan(has_layers=any(not isinstance(layer, ScreenLayer) for layer in self.layers))
        if moved is None:
            self._resources.look_from(1)
            left.draw_result.fetch_lists()  # the right eye makes others
        with self.device.event(pair.view.name):
            plan = moved or plan
            self._run(plan, right, self._label(plan))
        return right

    def _draw_layers(self, frame: Frame, has_late_layers: bool) -> None:
        """Draw the layers over a frame, but for those of the screen; `has_late_layers` says whether no pass has
        drawn those of the scene."""
        for layer in self.layers:
            if has_late_layers and isinstance(layer, SceneLayer):
                layer.render(self.device, frame)
        if frame.targets.output_image is not None:
            scale_image(frame, frame.targets.output_image)
        for layer in self.layers:
            if not isinstance(layer, SceneLayer | ScreenLayer):
                layer.render(self.device, frame)

    def _finish(
        self, before: Statistics, after: Statistics, image: Texture, frames: Sequence[Frame], turn: int | None
    ) -> FrameResult:
        """Return the result of a frame, with the difference of the device's counters."""
        simulator, left = self._resources.simulator, frames[0]
        counters = {
            "queries": after.queries - before.queries,
            "software_state_changes": after.software_state_changes - before.software_state_changes,
            "hardware_state_changes": after.hardware_state_changes - before.hardware_state_changes,
            "upload_bytes": after.upload_bytes - before.upload_bytes,
            "simulation_steps": simulator.steps,
            "skipped_simulations": len(simulator) - simulator.drawn_count if len(simulator.objects) else 0,
        }
        targets = left.targets
        return FrameResult(image, targets.depth, targets, left.statistics, tuple(frames), counters, turn)

    def _repeat(self, steady: _SteadyFrame, camera: Camera, seconds: float) -> FrameResult | None:
        """Draw a frame in which only the camera differs from the last one's by `steady.repeat`. Return None, before
        any command, if the frame needs more than that."""
        repeat, scene, view, targets = steady.repeat, self.scene, self._view, self._targets
        if (
            repeat is None
            or self.layers
            or (camera := self._fit(camera)).projection is not steady.projection
            or not scene.nodes.is_current
            or scene.snapshot() != self._snapshot
            or steady.settings != self._settings()
        ):
            return None
        before = self.device.statistics
        self._steady = None  # until all has gone well
        record = repeat(camera)
        self._steady = steady
        if record is None:
            return None
        self._set_time(seconds)
        scene.skip_refresh()
        frame = Frame(
            self.device,
            view,
            self._resources,
            targets,
            steady.effects,
            precision=self.precision,
            values=steady.values,
            _seen={view: record},
        )
        after = self.device.statistics
        self.show(targets.image)
        return self._finish(before, after, targets.image, [frame], None)

    def _prepare_repeat(self, steady: _SteadyFrame) -> None:
        """Find the function that repeats a frame which the last one's commands have drawn."""
        steady.is_repeated = True
        if steady.watch is not None and self._targets.output_image is None:
            steady.repeat = repeat_frame(
                steady.plan,
                steady.values,
                steady.events[0],
                self._view,
                self._resources,
                self._recent_features,
                steady.watch,
            )

    def _list_eyes(self) -> list[tuple[View, Targets]]:
        """The views that a frame draws, each with its targets: one, or the left and the right eye's."""
        pair = self._pair
        eyes = [(self._view, self._targets)]
        if pair is None or pair.stereo.is_reprojected:
            return eyes
        eyes.append((pair.view, pair.targets))
        return [eyes[pair.camera_index]] if pair.stereo.takes_turns else eyes

    def _begin_steady(self, camera: Camera, seconds: float) -> _SteadyFrame | None:
        """Begin a frame in which only the camera differs from the last one's, so that most of what `_begin`
        does would change nothing. Return None, and leave the rest to `_begin`, if anything else differs."""
        steady, before = self._steady, self._snapshot
        scene, resources = self.scene, self._resources
        self._steady = None
        self._snapshot = None if resources.may_simulate or not scene.nodes.is_current else scene.snapshot()
        if (
            steady is None
            or self._snapshot is None
            or self._snapshot != before
            or steady.settings != self._settings()
        ):
            return None
        if camera.projection is not steady.projection:
            camera = self._fit(camera)
            projection = camera.projection
            if (is_parallel(projection), projection.depth) != (
                is_parallel(steady.projection),
                steady.projection.depth,
            ):
                return None
        features, watch = self._recent_features, steady.watch
        visible_features = features.choose_shader_features(camera, is_unchanged=True)
        if not (
            watch.shows_same(camera, visible_features, features.shows_objects)
            if watch is not None
            else are_effects_same(
                steady.effects, scene, camera, visible_features, features.shows_objects, resources.reaching
            )
        ):
            features.reconsider()
            return None
        self._view.aim(camera)
        if resources.uses_levels:
            self._limit_detail()
        if self._animation_step:
            self._set_time(seconds)
        else:
            scene.seconds = seconds
        scene.skip_refresh()
        resources.follow(self._view)
        self._steady = steady
        return steady

    def _begin(self, camera: Camera, seconds: float) -> _SteadyFrame:
        """Bring everything on the device up to date with the scene, and plan the frame."""
        resources, pair = self._resources, self._pair
        self.scene.check_numbers("render")
        simulator = resources.simulator
        if self._is_temporal:
            around = self._aim_samples(camera, seconds)
            # What the last frame's view has seen, for its next frame: that isn't this one, if eyes take turns.
            self._last_view.workspace(SceneMotion).begin_frame(resources)
            self._last_view = self._list_eyes()[0][0]
        else:
            around = self._aim(camera)
        expected = simulator.drawn_objects
        simulator.begin_frame(self._set_time(seconds))
        self.scene.refresh()
        simulator.slow_down(around, self._targets.size[1], self._animation_lag)
        eyes = [view for view, _ in self._list_eyes()]
        if resources.images is not None:
            resources.images.advance(self._place_cameras(self._fit(camera)), self._targets.size)
        resources.update(*(eye.camera for eye in eyes), views=[eye.buffer for eye in eyes])
        if resources.uses_levels:
            self._limit_detail()
        resources.face(around)
        resources.hidden.begin_frame(None if self.simulates_hidden or pair is not None else around)
        resources.simulate_expected(around, expected, simulator.diverging if self.simulates_hidden else None)
        features = self._recent_features.choose_shader_features(around)
        effects = self._collect_effects(around, features, self._recent_features.shows_objects)
        plan = self._plan(effects)
        if plan is not self._last_plan:
            self._last_plan = plan
            if not effects.has_shadow_casters:
                resources.release(ShadowMaps)
            if not effects.temporal.is_on:
                for view in [self._view] if pair is None else [self._view, pair.view]:
                    view.release(SceneMotion)
            if self.scene.environment is None:
                resources.release(EnvironmentMaps)
            if resources.source_shapes is None:
                resources.release(LobeTable)
        is_steady = (
            self._snapshot is not None
            and pair is None
            and not (effects.has_shadow_casters or any(texture.has_history for texture in plan.textures))
        )
        watch = watch_lights(effects, self.scene, resources.reaching) if is_steady else None
        steady = _SteadyFrame(
            self._settings(), around.projection, effects, plan, {}, watch, self._label(plan)
        )
        if is_steady:
            self._steady = steady
        return steady

    def _settings(self) -> tuple[object, ...]:
        """The settings of a frame that may be exchanged between two frames, but for those that forget
        `_steady`."""
        technique = self.technique
        return (
            technique.current if isinstance(technique, AutoTechnique) else technique,
            self._view.visibility,
            self.blending,
            self.precision,
            self.bloom,
            self.occlusion,
            self.depth_of_field,
            self.temporal,
            self.environment,
            self.light_component,
            self._resources.simulator,
        )

    def _set_time(self, seconds: float) -> float:
        """Set the time of the scene; return the time that its animations have."""
        if self._animation_step:
            seconds = count_steps(seconds, self._animation_step) * self._animation_step
        self.scene.seconds = seconds
        return seconds

    def _aim(self, camera: Camera) -> Camera:
        """Aim the views of a frame through `camera`; return a camera that sees all that they see."""
        camera = self._fit(camera)
        if self._pair is None:
            self._view.aim(camera)
            return camera
        stereo, right = self._pair.stereo, self._pair.view
        rig = self._pair.fit_rig(camera)
        around = rig.enclose(camera)
        right.visibility = self._view.visibility
        eyes = list(zip((self._view, right), rig.place_eyes(camera), strict=True))
        for view, eye in [eyes[self._pair.camera_index]] if stereo.takes_turns else eyes:
            view.aim(eye, around)
        return around

    def _limit_detail(self) -> None:
        """Set the limit of levels of detail: that of all eyes."""
        resources, cameras = self._resources, [view.camera for view, _ in self._list_eyes()]
        resources.detail_limit = DetailLimit.compute(cameras, self._targets.size, resources.detail_error)

    @property
    def _is_temporal(self) -> bool:
        """True if samples of many frames are put together, unless the view shows one color."""
        technique = self.technique
        return self.temporal.is_on and not (isinstance(technique, Inspection) and not technique.is_lit)

    def forget_history(self) -> None:
        """Begin temporal anti-aliasing anew with the next frame, as after a cut: it shows nothing of earlier ones.

        That isn't needed after a turn of more than 30 degrees, a move of more than a 16th of the scene's diagonal, a
        change of the size, or where time goes back or on by more than half a second."""
        self._forgets_history = True

    def _aim_samples(self, camera: Camera, seconds: float) -> Camera:
        """As `_aim`, with views whose samples are at this frame's offset from the middles of pixels."""
        camera, pair = self._fit(camera), self._pair
        around, eyes = camera, [(self._view, self._targets, camera)]
        if pair is not None:
            rig = pair.fit_rig(camera)
            around, (left, right) = rig.enclose(camera), rig.place_eyes(camera)
            pair.view.visibility = self._view.visibility
            eyes = [(self._view, self._targets, left), (pair.view, pair.targets, right)]
            if pair.stereo.takes_turns:  # the other one's history is that of its last frame
                eyes = [eyes[pair.camera_index]]
        plan = self._last_plan
        # Several samples of a pixel are spread over all of it: only the gaps between them are left.
        samples = 1 if plan is None else max(texture.samples for texture in plan.textures)
        offset = compute_offset(self._sample_index, samples)
        self._sample_index += 1
        forgets = self._forgets_history or not 0.0 <= seconds - self._last_seconds <= _LONGEST_PAUSE
        self._forgets_history, self._last_seconds = False, seconds
        is_still = self._count_still_frames(camera, seconds) >= STILL_AFTER
        for view, targets, eye in eyes:
            history = view.workspace(TemporalHistory)
            history.begin_frame(self.scene, eye, offset, is_still=is_still, forgets=forgets)
            view.aim(shift_samples(eye, offset, targets.size), around)
        return around

    def _count_still_frames(self, camera: Camera, seconds: float) -> int:
        """Return for how many frames nothing has changed that a frame depends on."""
        resources, uploads = self._resources, self.uploads
        maps = resources.existing_workspace(ShadowMaps)
        tessellator = resources.existing_workspace(Tessellator)
        has_scene_layers = any(isinstance(layer, SceneLayer) for layer in self.layers)
        state = (
            self._snapshot,
            self._settings(),
            camera.position.tobytes(),
            camera.rotation.tobytes(),
            camera.projection,
            self.light_cutoff,
            self.detail_error,
            None if maps is None else maps.settings,
            None if tessellator is None else tessellator.settings,
            tuple(map(id, self.layers)),
            seconds if has_scene_layers else None,
        )
        is_same = (
            self._snapshot is not None and (uploads is None or uploads.is_done) and state == self._still_state
        )
        self._still_frames = self._still_frames + 1 if is_same else 0
        self._still_state = state
        return self._still_frames

    def _fit(self, camera: Camera) -> Camera:
        """The camera with the image's aspect. Equal projections become one, so that frames know them again."""
        size, unfitted, fitted = self._fitted
        projection = camera.projection
        if size != self._size or (projection is not unfitted and projection != unfitted):
            width, height = self._size
            fitted = projection.with_aspect(width / height)
            self._fitted = self._size, projection, fitted
        return camera if fitted is projection else camera.with_projection(fitted)

    def _label(self, plan: Plan[Frame]) -> list[AbstractContextManager[None]]:
        """Return the label of each pass of a plan."""
        return [self.device.event(frame_pass.name) for frame_pass in plan.passes]

    def _run(self, plan: Plan[Frame], frame: Frame, events: Sequence[AbstractContextManager[None]]) -> None:
        """Run the passes of a plan, each with its label."""
        frame.targets.provide(plan.textures)
        for frame_pass, event in zip(plan.passes, events, strict=True):
            with event:
                frame_pass.run(frame)

    def plan(self, camera: Camera) -> tuple[FrameEffects, Plan[Frame]]:
        """Return the effects of a frame of `camera`, and its plan. Nothing is drawn."""
        camera = self._fit(camera)
        if self._pair is not None:
            camera = self._pair.fit_rig(camera).enclose(camera)
        self.scene.lights.refresh()
        effects = self._collect_effects(camera)
        return effects, self._plan(effects)

    def _collect_effects(
        self,
        camera: Camera,
        recent_features: frozenset[str] | None = None,
        shows_objects: bool | None = None,
    ) -> FrameEffects:
        resources = self._resources
        maps = resources.existing_workspace(ShadowMaps)
        self._effects = collect_frame_effects(
            self.scene,
            camera,
            reaches=resources.reaching,
            blending=self.blending,
            bloom=self.bloom,
            occlusion=self.occlusion,
            depth_of_field=self.depth_of_field,
            temporal=self.temporal if self._is_temporal else NO_HISTORY,
            environment=self.environment,
            component=self.light_component,
            filters_penumbras=maps is not None and maps.settings.filter is ShadowFilter.PCSS,
            follows_contacts=maps is not None and maps.settings.contact_length > 0.0,
            visible_features=recent_features,
            shows_objects=shows_objects,
            lights=resources.lights,
            widest=self._widest_blended,
            last=self._effects,
        )
        return self._effects

    def _plan(self, effects: FrameEffects) -> Plan[Frame]:
        """Return the plan of a frame with these effects; each is made once."""
        technique = self.technique
        if isinstance(technique, AutoTechnique):
            technique = technique.current
        if self._planned_technique is not technique:
            self._plans.clear()
            self._planned_technique = technique
        plan = self._plans.get(effects.key)
        if plan is None:
            is_lit = not isinstance(technique, Inspection) or technique.is_lit
            before = [
                *tessellation_passes(effects),
                *(shadow_passes(effects, bind_depth_programs) if is_lit else ()),
                *(environment_passes(effects) if is_lit else ()),
                *(occlusion_passes(effects) if is_lit else ()),
                *(contact_passes(effects) if is_lit else ()),
            ]
            passes = technique.declare(effects)
            after = temporal_passes(effects, last_version(passes, "image"))
            plan = self._plans[effects.key] = make_plan([*before, *passes, *after])
        return plan

    def destroy(self) -> None:
        """Destroy all resources on the device, except those of layers and of a visibility algorithm that was
        passed in."""
        self._destroy_algorithms()
        if self._pair is not None:
            self._pair.destroy()
        self._targets.destroy()
        self._view.destroy()
        self._resources.destroy()

    def _destroy_algorithms(self) -> None:
        for visibility in self._named_algorithms.values():
            visibility.destroy()
        self._named_algorithms.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.destroy()
