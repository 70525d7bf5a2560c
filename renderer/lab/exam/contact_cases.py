"""Contact shadows, compared with rays in float64.

Small things stand on a floor, in maps whose texels are as wide as they are. The error is how far frames are from the
reference, in that of the same frames with maps alone: what the image doesn't show is left. With a sun of 8°, penumbras
are compared with rays to all of its disc.
"""

from __future__ import annotations

from functools import cache, partial
from typing import Final, NamedTuple

import numpy as np

from renderer.content import BUILT_IN
from renderer.lab.exam.case import CaseImage, CaseResult, Measures, check_early, largest_error
from renderer.lab.exam.scenes import shows_something
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.renderer import Renderer
from renderer.scene import Camera, Orthographic, Perspective, Scene, SceneBuilder, scaling, translation
from renderer.scene.arrays import Floats
from renderer.shadows import ShadowFilter, ShadowSettings
from rhi import Device

_SIZE: Final = (192, 128)
_ASPECT: Final = _SIZE[0] / _SIZE[1]
_MAPS: Final = ShadowSettings(cascades=1, cascade_size=128, distance=20.0)
_FARTHEST_OF_MAPS: Final = 4.0
"""Levels that images of maps alone are off, with a sun of a size; a worse image would make any other look good."""
_EYE: Final = Camera.look_at((0.0, 1.3, 1.6), (0.0, 0.0, 0.0), projection=Perspective(0.9, _ASPECT))


class ContactView(NamedTuple):
    """The camera of a view, how thick things are taken to be there, the technique that draws it, and how far from the
    origin, in metres along each axis, it is."""

    camera: Camera
    thickness: float
    technique: str = "forward"
    offset: float = 0.0


_VIEWS: Final = {
    "from the side": ContactView(_EYE, 0.06),
    "in a deferred technique, far from the origin": ContactView(_EYE, 0.06, "deferred", 1e5),
    "from above, in parallel": ContactView(
        Camera.look_at((0, 3, 0), (0, 0, 0), (0, 0, -1), Orthographic(1.4, _ASPECT, 0.0, 8.0)), 0.3
    ),
}


def make_pebbles(offset: float, diameter: float = 0.0) -> Scene:
    """Make boxes and balls on a floor in the light of a sun that fills an angle of `diameter`."""
    builder, random = SceneBuilder("pebbles"), np.random.default_rng(8)
    box, ball = (builder.add_mesh(BUILT_IN[name]()) for name in ("box", "sphere"))
    grey = builder.add_material(base_color=(0.6, 0.58, 0.55), specular_color=(0.0, 0.0, 0.0))
    floor = builder.add_node(translation(np.add((0.0, -0.5, 0.0), offset)) @ scaling((9.0, 1.0, 9.0)))
    builder.add_objects(floor, box, grey)
    for number in range(24):
        size = random.uniform(0.06, 0.14)
        middle = np.array((random.uniform(-0.9, 0.9), size / 2, random.uniform(-0.6, 0.6)))
        node = builder.add_node(translation(middle + offset) @ scaling((size, size, size)))
        builder.add_objects(node, box if number % 2 else ball, grey)
    builder.lights.add_directional((0.6, -0.7, 0.15), casts_shadow=True, angular_diameter=diameter)
    builder.lights.sky = builder.lights.ground = (0.15, 0.17, 0.2)
    return builder.build()


@cache  # the same for each device
def trace_view(title: str, diameter: float = 0.0) -> Floats:
    """The ray-traced image (h, w, 3) of a view, in levels."""
    tracer = RayTracer(make_pebbles(0.0, diameter), has_penumbras=diameter > 0.0)
    return tracer.draw(_VIEWS[title].camera, _get_size(diameter))


def _get_size(diameter: float) -> tuple[int, int]:
    """The size of images: rays to all of a disc take long."""
    return (_SIZE[0] * 3 // 4, _SIZE[1] * 3 // 4) if diameter > 0.0 else _SIZE


def _draw(device: Device, view: ContactView, length: float, diameter: float = 0.0, rays: int = 1) -> Floats:
    """Draw a view with rays of this length; return its levels (h, w, 3)."""
    camera = Camera(view.camera.position + view.offset, view.camera.rotation, view.camera.projection)
    scene = make_pebbles(view.offset, diameter)
    size = _get_size(diameter)
    with Renderer(device, scene, technique=view.technique, visibility="none", size=size) as renderer:
        renderer.shadows.settings = ShadowSettings(
            filter=ShadowFilter.PCSS if diameter > 0.0 else ShadowFilter.SMOOTH,
            cascades=_MAPS.cascades,
            cascade_size=_MAPS.cascade_size,
            distance=_MAPS.distance,
            contact_length=length,
            contact_steps=32,
            contact_rays=rays,
            contact_thickness=view.thickness,
        )
        renderer.render(camera)
        return renderer.render(camera).image.read()[..., :3].astype(np.float64)


def measure_contacts(device: Device) -> CaseResult:
    """Draw the views with contact shadows and with maps alone, and compare both with rays."""
    numbers, holds, images = dict[str, object](), dict[str, bool](), dict[str, CaseImage]()
    error = 0.0
    for title, view in _VIEWS.items():
        expected = trace_view(title)
        maps, contacts = (_draw(device, view, length) for length in (0.0, 0.25))
        off = [float(np.abs(image - expected).mean()) for image in (maps, contacts)]
        share = 100.0 * off[1] / off[0]
        numbers[f"{title}: levels off with maps alone, and with rays"] = f"{off[0]:.3f}, {off[1]:.3f}"
        error = largest_error(error, share)
        for description, is_true in shows_something([contacts.astype(np.uint8)]).items():
            holds[f"{title}: {description}"] = is_true
        holds[f"{title}: rays take light away"] = bool((contacts < maps - 20).any())
        images |= {title: contacts.astype(np.uint8), f"{title}, maps alone": maps.astype(np.uint8)}
    return CaseResult(error, numbers, holds, lambda: images)


def measure_contact_penumbras(diameter: float, device: Device) -> CaseResult:
    """Draw the views with rays to the whole disc of the sun, to its middle and with maps alone, and compare all with
    rays."""
    numbers, holds, images = dict[str, object](), dict[str, bool](), dict[str, CaseImage]()
    error = 0.0
    for title in ("from the side",):
        view, expected = _VIEWS[title], trace_view(title, diameter)
        frames = [
            _draw(device, view, length, diameter, rays) for length, rays in ((0.0, 1), (0.25, 1), (0.25, 16))
        ]
        off = [float(np.abs(image - expected).mean()) for image in frames]
        figures = ", ".join(f"{levels:.3f}" for levels in off)
        numbers[f"{title}: levels off with maps alone, a ray and 16 rays"] = figures
        error = largest_error(error, 100.0 * off[2] / off[0])
        holds[f"{title}: 16 rays are nearer than a ray"] = off[2] < off[1]
        holds[f"{title}: maps alone are within {_FARTHEST_OF_MAPS} levels"] = off[0] <= _FARTHEST_OF_MAPS
        check_early(holds)
        for description, is_true in shows_something([frames[2].astype(np.uint8)]).items():
            holds[f"{title}: {description}"] = is_true
        images |= {title: frames[2].astype(np.uint8), f"{title}, by rays": expected.astype(np.uint8)}
        images[f"{title}, one ray"] = frames[1].astype(np.uint8)
    return CaseResult(error, numbers, holds, lambda: images)


MEASURES: Final[Measures] = {97: measure_contacts, 103: partial(measure_contact_penumbras, np.radians(8.0))}
