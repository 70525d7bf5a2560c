"""The second eye of a frame, the rig that suits a scene, and the image in which both are shown.

A frame of two eyes is the frame of the left one, then that of the right one, each with its view and its
targets, and all else shared: the simulation, the transforms, the light lists, the needs and the plan, and the
objects found where only a frustum decides. Passes know nothing of this. So every technique works, and each
eye's image is that of its camera, bit for bit.

For shutter glasses, a frame is that of one eye, and the next one that of the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Final

from renderer import rules
from renderer.frame import (
    IMAGE_FORMAT,
    Frame,
    FrameEffects,
    Plan,
    ScreenLayer,
    Target,
    Targets,
    View,
    make_plan,
)
from renderer.frame.far_objects import FarObjects
from renderer.scene import Camera, Scene, StereoRig
from renderer.stereo.mixing import MIXED_OUTPUTS, Mixer
from renderer.stereo.outputs import SHUTTER, check_output, eye_image_size
from renderer.stereo.reprojection import REPROJECTION
from renderer.stereo.screen_layers import ScreenLayers
from renderer.visibility.algorithm import to_selecting
from renderer.visibility.boxes.depth_range import compute_depth_range
from renderer.visibility.command_cache import CommandCache, copy
from rhi import Device, Encoder, Region, Texture, refuse
from rhi.math import is_parallel

_MIN_NEAR_RATIO: Final = (
    1e-3  # of the farthest depth: an orthographic projection may see what is behind the eye
)


def compute_rig(
    scene: Scene,
    camera: Camera,
    *,
    eye_distance: float | None = None,
    convergence: float | None = None,
    is_toed_in: bool = False,
) -> StereoRig:
    """Return the comfortable rig for what `camera` sees of `scene`; the arguments replace its values."""
    depths = compute_depth_range(scene, camera)
    rig = StereoRig()
    if depths is not None and depths[1] > 0.0:
        nearest, farthest = depths
        rig = StereoRig.comfortable(camera.projection, max(nearest, _MIN_NEAR_RATIO * farthest), farthest)
    return StereoRig(
        rig.eye_distance if eye_distance is None else eye_distance,
        rig.convergence if convergence is None else convergence,
        is_toed_in,
    )


@dataclass(frozen=True, slots=True)
class Stereo:
    """Settings of two eyes: their rig, and the image that shows both.

    Attributes:
        rig: where the eyes are.
        output: one of `OUTPUTS`.
        is_swapped: whether the left eye's image is shown to the right eye and the other way round.
        is_reprojected: whether the right eye's image is made from the left one's instead of being drawn.
        far_error: the largest error in pixels that parallax may have where objects are drawn once for both eyes,
            because they are far; 0 draws all for each eye.
    """

    rig: StereoRig
    output: str = "dubois"
    is_swapped: bool = False
    is_reprojected: bool = False
    far_error: float = 0.0

    def __post_init__(self) -> None:
        check_output(self.output, "Stereo(output=...)")
        rules.check_non_negative(rules.BAD_STEREO, "Stereo(far_error=...)", self.far_error)
        if self.is_reprojected and self.rig.is_toed_in:
            refuse(rules.BAD_STEREO, "Stereo(is_reprojected=...)", True, "eyes that aren't toed in")
        if self.is_reprojected and self.takes_turns:
            refuse(
                rules.BAD_STEREO,
                "Stereo(is_reprojected=...)",
                True,
                "an output that shows both eyes in a frame",
            )

    @property
    def takes_turns(self) -> bool:
        """True if a frame is that of one eye, and the next one that of the other."""
        return self.output == SHUTTER


def compute_far_rig(rig: StereoRig, scale: float, width: int, error: float) -> tuple[StereoRig, float, int]:
    """Return a rig for which what is far has nearly the same parallax, the distance from which on that is so, and that
    parallax in whole pixels.

    It is exact at this distance, and `error` pixels too small at infinity. All parallax of the rig differs from that of
    the given one by the same number of pixels: a half at most, unless it is negative everywhere.

    Args:
        scale: the horizontal scale of the projection.
        width: that of an eye's image in pixels.
    """
    reach = 0.5 * scale * rig.eye_distance * width  # pixels times metres
    shift = max(round(reach / rig.convergence - error), 0)
    convergence = reach / (shift + error) if reach else rig.convergence
    return replace(rig, convergence=convergence), reach / error, shift


def draws_objects_once(plan: Plan[Frame], effects: FrameEffects) -> bool:
    """True if a plan draws the visible objects in one pass, with one sample a pixel, to textures that no pass writes
    before; so what is far may be drawn for both eyes there."""
    drawing = [frame_pass for frame_pass in plan.passes if frame_pass.draws_objects]
    if len(drawing) != 1 or effects.temporal.is_on:
        return False
    written = [target for target in drawing[0].writes if isinstance(target, Target)]
    first = {shared.names[0] for shared in plan.textures}
    return all(target.samples == 1 and target.name in first for target in written)


IMAGE_PLAN: Final = make_plan(REPROJECTION, ("image",))
"""The plan of a right eye's frame whose image is reprojected."""
IMAGE_AND_DEPTH_PLAN: Final = make_plan(REPROJECTION)
"""The same with depth, for layers."""


class EyePair:
    """The right eye beside the view of the left one, and the image of both.

    Attributes:
        stereo: how the eyes are shown; it may be exchanged for one whose images have the same size.
        view, targets: those of the right eye.
        image: what is shown, unless the eyes take turns.
        turn: of eyes that take turns, the one that this frame is shown to: 0 is the left one, 1 the right one.
    """

    def __init__(
        self, device: Device, stereo: Stereo, size: tuple[int, int], left: View, scale: float = 1.0
    ) -> None:
        self.stereo = stereo
        self.turn = 0
        self._device = device
        self._screen_layers: ScreenLayers | None = None
        self._far_shift: tuple[float, int] | None = None
        with ExitStack() as created:
            self.image: Texture = created.enter_context(device.texture(size, IMAGE_FORMAT, label="both eyes"))
            self.targets = Targets(device, eye_image_size(stereo.output, size), scale)
            created.callback(self.targets.destroy)
            self.view = View(device, "right eye", left.visibility, left.batch)
            created.callback(self.view.destroy)
            self._mixer = Mixer(device)
            created.callback(self._mixer.destroy)
            self._commands = CommandCache(device, "")
            self._resources = created.pop_all()

    def fit_rig(self, camera: Camera) -> StereoRig:
        """The rig for a camera: that of the settings, unless what is far is drawn once. Then its convergence is such
        that what is far has a parallax of whole pixels."""
        stereo, self._far_shift = self.stereo, None
        if (
            not stereo.far_error
            or stereo.is_reprojected
            or stereo.takes_turns
            or stereo.rig.is_toed_in
            or is_parallel(camera.projection)
        ):
            return stereo.rig
        scale = float(camera.projection.matrix[0, 0])
        rig, distance, shift = compute_far_rig(stereo.rig, scale, self.targets.size[0], stereo.far_error)
        self._far_shift = distance, shift
        return rig

    def share_far(self, left: View, left_targets: Targets, plan: Plan[Frame], effects: FrameEffects) -> None:
        """Prepare the views of a frame to draw far objects once, if its plan can."""
        left.far = self.view.far = None
        if (
            self._far_shift is not None
            and draws_objects_once(plan, effects)
            and to_selecting(left.visibility) is not None
        ):
            distance, shift = self._far_shift
            left_targets.provide(plan.textures)
            self.targets.provide(plan.textures)
            left.far = self.view.far = FarObjects(
                distance, shift, self.view.camera, left_targets, self.targets
            )

    @property
    def camera_index(self) -> int:
        """Of eyes that take turns, the index of the camera that draws this frame."""
        return self.turn ^ self.stereo.is_swapped

    def plan(self, *, has_layers: bool) -> Plan[Frame] | None:
        """Return the plan of the right eye's frame, None if it is that of the left one."""
        if not self.stereo.is_reprojected:
            return None
        return IMAGE_AND_DEPTH_PLAN if has_layers else IMAGE_PLAN

    def show(self, left: Frame, right: Frame, layers: Sequence[ScreenLayer] = ()) -> Texture:
        """Draw the images of both frames to `image`, and layers over them; return it."""
        output, image = self.stereo.output, self.image
        first, second = left.targets.image, right.targets.image
        if self.stereo.is_swapped:
            first, second = second, first
        if output in MIXED_OUTPUTS:
            self._mixer.mix(output, first, second, image)
        else:
            self._commands.execute(
                (first, second, image), lambda encoder: _copy_side_by_side(encoder, first, second, image)
            )
        if layers:
            self._screen_layers = self._screen_layers or ScreenLayers(self._device)
            self._screen_layers.draw(layers, output, left, image)
        elif self._screen_layers is not None:
            self._screen_layers.destroy()
            self._screen_layers = None
        return image

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._commands.forget()
        if self._screen_layers is not None:
            self._screen_layers.destroy()
        self._resources.close()


def _copy_side_by_side(encoder: Encoder, first: Texture, second: Texture, image: Texture) -> None:
    """Copy two images to the halves of an image, side by side or one over the other."""
    (width, height), (x, y) = image.size, first.size
    x, y = (x, 0) if x < width else (0, y)
    copy(encoder, first, image)
    if x < width and y < height:
        copy(encoder, second, image, region=Region(0, 0, width - x, height - y), x=x, y=y)
