"""The second eye of a frame, the rig that suits a scene, and the image in which both are shown.

A frame of two eyes is the frame of the left one, then that of the right one, each with its view and its targets, and
all else shared: the simulation, the transforms, the light lists, the needs and the plan, and the objects found where
only a frustum decides. Passes know nothing of this. So every technique works, and each eye's picture is that of its
camera, bit for bit.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from typing import Final

from renderer import rules
from renderer.frame import IMAGE_FORMAT, Frame, Plan, Targets, View, make_plan
from renderer.scene import Camera, Scene, StereoRig
from renderer.stereo.mixing import MIXED, Mixer
from renderer.stereo.outputs import check_output, fit_picture
from renderer.stereo.reprojection import REPROJECTION
from renderer.visibility.boxes.depth_range import find_depth_range
from renderer.visibility.repeated import RepeatedCommands, copy
from rhi import Device, Encoder, Region, Texture, refuse

_LEAST: Final = 1e-3  # of the farthest depth: a parallel lens may see what is behind the eye


def find_rig(
    scene: Scene,
    camera: Camera,
    *,
    eye_distance: float | None = None,
    convergence: float | None = None,
    is_toed_in: bool = False,
) -> StereoRig:
    """Return the rig that is comfortable for what `camera` sees of `scene`, with what is given instead."""
    depths = find_depth_range(scene, camera)
    rig = StereoRig()
    if depths is not None and depths[1] > 0.0:
        nearest, farthest = depths
        rig = StereoRig.comfortable(camera.projection, max(nearest, _LEAST * farthest), farthest)
    return StereoRig(
        rig.eye_distance if eye_distance is None else eye_distance,
        rig.convergence if convergence is None else convergence,
        is_toed_in,
    )


@dataclass(frozen=True, slots=True)
class Stereo:
    """Settings of two eyes: their rig, and the image that shows both.

    Attributes:
        rig: where the eyes are. output: one of `OUTPUTS`.
        is_swapped: whether the left eye's picture is shown to the right eye and the other way round.
        is_reprojected: whether the right eye's picture is made from the left one's instead of being drawn.
    """

    rig: StereoRig
    output: str = "dubois"
    is_swapped: bool = False
    is_reprojected: bool = False

    def __post_init__(self) -> None:
        check_output(self.output, "Stereo(output=...)")
        if self.is_reprojected and self.rig.is_toed_in:
            refuse(rules.BAD_STEREO, "Stereo(is_reprojected=...)", True, "eyes that aren't toed in")


PICTURE: Final = make_plan(REPROJECTION, ("image",))
"""The plan of a right eye's frame whose picture is reprojected."""
PICTURE_AND_DEPTH: Final = make_plan(REPROJECTION)
"""The same with depth, for layers."""


class EyePair:
    """The right eye beside the view of the left one, and the image of both.

    Attributes:
        stereo: how the eyes are shown; it may be exchanged for one whose pictures have the same size.
        view, targets: those of the right eye. image: what is shown.
    """

    def __init__(self, device: Device, stereo: Stereo, size: tuple[int, int], left: View, scale: float = 1.0) -> None:
        self.stereo = stereo
        with ExitStack() as made:
            self.image: Texture = made.enter_context(device.texture(size, IMAGE_FORMAT, label="both eyes"))
            self.targets = Targets(device, fit_picture(stereo.output, size), scale)
            made.callback(self.targets.destroy)
            self.view = View(device, "right eye", left.visibility, left.batch)
            made.callback(self.view.destroy)
            self._mixer = Mixer(device)
            made.callback(self._mixer.destroy)
            self._commands = RepeatedCommands(device, "")
            self._made = made.pop_all()

    def plan(self, *, has_layers: bool) -> Plan[Frame] | None:
        """Return the plan of the right eye's frame, None if it is that of the left one."""
        if not self.stereo.is_reprojected:
            return None
        return PICTURE_AND_DEPTH if has_layers else PICTURE

    def show(self, left: Frame, right: Frame) -> Texture:
        """Draw the pictures of both frames to `image`, and return it."""
        output, image = self.stereo.output, self.image
        first, second = left.targets.image, right.targets.image
        if self.stereo.is_swapped:
            first, second = second, first
        if output in MIXED:
            self._mixer.mix(output, first, second, image)
        else:
            self._commands.execute((first, second, image), lambda encoder: _place(encoder, first, second, image))
        return image

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._commands.forget()
        self._made.close()


def _place(encoder: Encoder, first: Texture, second: Texture, image: Texture) -> None:
    """Copy two pictures to the halves of an image, side by side or one over the other."""
    (width, height), (x, y) = image.size, first.size
    x, y = (x, 0) if x < width else (0, y)
    copy(encoder, first, image)
    if x < width and y < height:
        copy(encoder, second, image, region=Region(0, 0, width - x, height - y), x=x, y=y)
