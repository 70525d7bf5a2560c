"""Contact shadows: rays over the depth buffer compared with rays to boxes in float64, alike in all techniques, and for
nothing where nothing calls for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from nightly_reasons import FEWER_CASES, ONLY_KERNELS
from numpy.typing import NDArray

import rhi
from renderer.content import BUILT_IN
from renderer.frame import Effect, Frame, FrameEffects, FramePass, LightComponent
from renderer.renderer import Renderer
from renderer.rules import BAD_SHADOWS
from renderer.scene import (
    AlphaMode,
    Camera,
    Orthographic,
    Perspective,
    Scene,
    SceneBuilder,
    scaling,
    translation,
)
from renderer.scene.arrays import Floats
from renderer.shadows import ShadowSettings
from renderer.techniques import TECHNIQUES, ResourceCapture
from rhi import Op, ValidationError
from tests.renderer.conftest import open_device

SIZE = (192, 128)
SUN = np.array((0.6, -0.7, 0.15)) / np.linalg.norm((0.6, -0.7, 0.15))
EYE = Camera.look_at((0.0, 1.6, 2.2), (0.0, 0.0, 0.0), projection=Perspective(0.9, 1.5))
ABOVE = Camera.look_at((0.0, 3.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, -1.0), Orthographic(1.6, 1.5, 0.0, 8.0))
BOXES = (
    ((0.0, -0.5, 0.0), (8.0, 1.0, 8.0)),
    ((-0.6, 0.1, 0.2), (0.2, 0.2, 0.2)),
    ((0.2, 0.05, -0.3), (0.1, 0.1, 0.3)),
    ((0.5, 0.15, 0.4), (0.12, 0.3, 0.12)),
    ((-0.1, 0.08, 0.6), (0.16, 0.16, 0.16)),
)
"""A floor and things on it: middles and sizes."""
CONTACTS = ShadowSettings(
    cascades=1, cascade_size=64, distance=20.0, contact_length=0.25, contact_steps=64, contact_thickness=0.15
)
"""Texels of 30 cm, wider than what stands on the floor, and rays of 25 cm."""


def make_boxes(
    offset: float = 0.0, *, casts: bool = True, lights: int = 1, is_glass: bool = False, points: int = 0
) -> Scene:
    """Make the boxes in the light of the sun, moved by `offset` along each axis."""
    builder = SceneBuilder("boxes")
    box = builder.add_mesh(BUILT_IN["box"]())
    grey = builder.add_material(base_color=(0.6, 0.6, 0.6), specular_color=(0.0, 0.0, 0.0))
    for middle, size in BOXES:
        node = builder.add_node(translation(np.add(middle, offset)) @ scaling(size))
        builder.add_objects(node, box, grey)
    if is_glass:
        glass = builder.add_material(base_color=(0.6, 0.6, 0.6, 0.5), alpha_mode=AlphaMode.BLEND)
        node = builder.add_node(translation(np.add((0.0, 0.9, 0.0), offset)) @ scaling((4.0, 0.01, 4.0)))
        builder.add_objects(node, box, glass)
    for number in range(lights):
        direction = SUN if number == lights - 1 else (0.0, -1.0, 0.0)
        builder.lights.add_directional(direction, casts_shadow=casts and number == lights - 1)
    for number in range(points):
        builder.lights.add_point((0.5 - number, 1.0, 0.5), 4.0)
    builder.lights.sky = builder.lights.ground = (0.1, 0.1, 0.1)
    builder.views["eye"] = EYE
    return builder.build()


def move(camera: Camera, offset: float) -> Camera:
    """Return the camera moved along each axis."""
    return replace(camera, position=np.add(camera.position, offset))


class ContactCapture(ResourceCapture):
    """Reads a resource of the plan that isn't the technique's own."""

    def declare(self, effects: FrameEffects) -> Sequence[FramePass[Frame]]:
        assert "contact_shadows" in effects.shading_reads
        read = FramePass("read", self._read, "is tested", reads=("contact_shadows",), has_side_effects=True)
        return *self._technique.declare(effects), read


def measure_shares(
    device: rhi.Device,
    scene: Scene,
    camera: Camera = EYE,
    technique: str = "forward",
    settings: ShadowSettings = CONTACTS,
) -> Floats:
    """Draw a frame; return the share (h, w) of the sun's light that contact shadows leave."""
    capture = ContactCapture(TECHNIQUES[technique](), "contact_shadows")
    with Renderer(device, scene, technique=capture, visibility="none", size=SIZE) as renderer:
        renderer.shadows.settings = settings
        renderer.render(camera)
        renderer.render(camera)
    assert capture.texels is not None
    return np.asarray(capture.texels.reshape(SIZE[1], SIZE[0], -1)[..., 0] / np.float64(255.0))


def draw(
    device: rhi.Device, scene: Scene, settings: ShadowSettings, technique: Any = "forward", **options: Any
) -> Floats:
    """Draw a frame; return its levels (h, w, 3)."""
    camera = options.pop("camera", EYE)
    with Renderer(device, scene, technique=technique, visibility="none", size=SIZE, **options) as renderer:
        renderer.shadows.settings = settings
        renderer.render(camera)
        return renderer.render(camera).image.read()[..., :3].astype(np.float64)


def intersect(start: Floats, way: Floats) -> tuple[Floats, Floats]:
    """Return where rays (…, 3) enter the first box that they meet, in lengths of `way`, and its normal; infinity if
    they meet none."""
    first, normal = np.full(start.shape[:-1], np.inf), np.zeros(start.shape)
    for middle, size in BOXES:
        with np.errstate(divide="ignore", invalid="ignore"):
            low = (np.subtract(middle, np.divide(size, 2)) - start) / way
            high = (np.add(middle, np.divide(size, 2)) - start) / way
        enters, leaves = np.fmin(low, high), np.fmax(low, high)
        enter, leave = enters.max(axis=-1), leaves.min(axis=-1)
        hits = (enter < leave) & (enter > 1e-9) & (enter < first)
        side = np.eye(3)[enters.argmax(axis=-1)] * -np.sign(way)
        first, normal = np.where(hits, enter, first), np.where(hits[..., None], side, normal)
    return first, normal


def follow_rays(camera: Camera, length: float) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the free part (h, w) of a ray to the sun from each pixel's surface, in that of `length`, and which of the
    surfaces face the sun."""
    width, height = SIZE
    x = (np.arange(width) + 0.5) / width * 2.0 - 1.0
    y = 1.0 - (np.arange(height) + 0.5) / height * 2.0
    matrix = camera.projection.matrix
    plane = np.stack(np.broadcast_arrays(x[None] / matrix[0, 0], y[:, None] / matrix[1, 1]), axis=-1)
    ahead = -np.ones((height, width, 1))
    if isinstance(camera.projection, Orthographic):
        start = camera.position + np.concatenate([plane, 0 * ahead], axis=-1) @ camera.rotation
        way = np.broadcast_to(np.array((0.0, 0.0, -1.0)) @ camera.rotation, start.shape)
    else:
        start = np.broadcast_to(camera.position, (height, width, 3))
        way = np.concatenate([plane, ahead], axis=-1) @ camera.rotation
    distance, normal = intersect(start, way)
    is_seen = np.isfinite(distance)
    hit = start + way * np.where(is_seen, distance, 0.0)[..., None]
    free, _ = intersect(hit + 1e-7 * normal, np.broadcast_to(-SUN * length, hit.shape))
    return np.minimum(free, 1.0), is_seen & (normal @ -SUN > 0.0)


@pytest.mark.nightly_cases("cl*", "wgpu*", reason=ONLY_KERNELS)
@pytest.mark.parametrize(
    ("camera", "thickness", "share"),
    [(EYE, 0.06, 0.35), (ABOVE, 0.3, 0.05)],
    ids=["from the side", "from above"],
)
def test_shadows_are_those_of_rays_in_float64(
    drawing_device: rhi.Device, camera: Camera, thickness: float, share: float
) -> None:
    free, faces = follow_rays(camera, CONTACTS.contact_length)
    blocked = faces & (free < 0.7)
    assert blocked.mean() > 0.005
    settings = replace(CONTACTS, contact_thickness=thickness)
    shares = measure_shares(drawing_device, make_boxes(), camera, settings=settings)
    # From the side, one thickness is too much for low boxes and too little for deep ones; from above it is right for
    # all, and only edges are off by a pixel.
    wrong = np.where(blocked, shares > 0.5, shares < 0.5) & faces & ((free < 0.7) | (free == 1.0))
    assert wrong.sum() < share * blocked.sum()
    assert np.count_nonzero(shares[~faces] < 1.0) <= 0.005 * shares.size


def test_without_rays_a_quarter_would_be_wrong() -> None:
    # The control of the tolerance above: no ray at all leaves all of the blocked pixels lit.
    free, faces = follow_rays(EYE, CONTACTS.contact_length)
    assert np.count_nonzero(faces & (free < 0.7)) > 30


@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_a_plane_does_not_block_its_own_light(gl: rhi.Device, offset: float) -> None:
    scene = make_boxes(offset)
    free, _ = follow_rays(EYE, CONTACTS.contact_length)
    shares = measure_shares(gl, scene, move(EYE, offset))
    open_floor = np.zeros(SIZE[::-1], bool)
    open_floor[:20] = True  # far from all boxes
    assert (free[:20] == 1.0).all()
    assert (shares[open_floor] == 1.0).all()


def test_a_floor_that_the_sun_grazes_is_lit(gl: rhi.Device) -> None:
    builder = SceneBuilder("floor")
    floor = builder.add_node(translation((0.0, -0.5, 0.0)) @ scaling((400.0, 1.0, 400.0)))
    builder.add_objects(floor, builder.add_mesh(BUILT_IN["box"]()), builder.add_material())
    low = Camera.look_at((0.0, 0.3, 2.2), (0.0, 0.1, 0.0), projection=Perspective(0.9, 1.5))
    for turn in np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False):
        builder.lights.directional = builder.lights.directional[:0]
        builder.lights.add_directional((np.cos(turn), -0.002, np.sin(turn)), casts_shadow=True)
        assert (measure_shares(gl, builder.build(), low) == 1.0).all()


def test_far_from_the_origin_shadows_are_the_same(gl: rhi.Device) -> None:
    near, far = measure_shares(gl, make_boxes()), measure_shares(gl, make_boxes(1e6), move(EYE, 1e6))
    assert np.count_nonzero(near != far) <= 20


def test_shadows_fade_towards_the_end_of_rays(gl: rhi.Device) -> None:
    shares = measure_shares(gl, make_boxes())
    assert np.count_nonzero((shares > 0.1) & (shares < 0.9)) > 3


def test_longer_rays_block_more(gl: rhi.Device) -> None:
    counts = [
        np.count_nonzero(
            measure_shares(gl, make_boxes(), settings=replace(CONTACTS, contact_length=length)) < 0.5
        )
        for length in (0.05, 0.1, 0.25)
    ]
    assert 0 < counts[0] < counts[1] < counts[2]


@pytest.mark.parametrize("camera", [ABOVE, EYE], ids=["from above", "from the side"])
def test_penumbras_are_the_mean_of_rays_to_all_of_the_disc(gl: rhi.Device, camera: Camera) -> None:
    """The mean of frames with suns without a size, whose directions are points of the disc in float64."""
    diameter, rays = 0.2, 4
    settings = replace(CONTACTS, contact_rays=rays, contact_thickness=0.3)
    scene = make_boxes()
    scene.lights.directional["angular_diameter"] = diameter
    soft = measure_shares(gl, scene, camera, settings=settings)
    to_sun = -SUN
    across = np.cross(to_sun, np.eye(3)[np.abs(to_sun).argmin()])
    across /= np.linalg.norm(across)
    turns = np.arange(rays) * np.pi * (3.0 - np.sqrt(5.0))
    radii = np.tan(diameter / 2.0) * np.sqrt((np.arange(rays) + 0.5) / rays)
    hard = []
    for turn, radius in zip(turns, radii, strict=True):
        aside = radius * (np.cos(turn) * across + np.sin(turn) * np.cross(to_sun, across))
        other = make_boxes()
        other.lights.directional["direction"] = -(to_sun + aside) / np.linalg.norm(to_sun + aside)
        hard.append(measure_shares(gl, other, camera, settings=settings))
    faces = np.abs(soft - 1.0) > 0.0
    off = np.abs(soft - np.mean(hard, axis=0))[faces]
    assert faces.mean() > 0.01
    assert (off > 0.02).mean() < 0.04  # of surfaces that only a part of the disc faces, and of rounding
    assert ((soft > 0.1) & (soft < 0.9)).mean() > 2.0 * ((hard[0] > 0.1) & (hard[0] < 0.9)).mean()


@pytest.mark.parametrize("technique", ["forward", "deferred"])
def test_the_number_of_rays_costs_nothing_where_the_sun_has_no_size(technique: str) -> None:
    few, many = (record(make_boxes(), replace(CONTACTS, contact_rays=rays), technique) for rays in (1, 64))
    assert few == many


def test_things_that_are_deeper_than_the_thickness_let_rays_through(gl: rhi.Device) -> None:
    thin, thick = (
        measure_shares(gl, make_boxes(), settings=replace(CONTACTS, contact_thickness=depth))
        for depth in (1e-4, 0.15)
    )
    assert np.count_nonzero(thin < 0.5) < 0.8 * np.count_nonzero(thick < 0.5)


def test_contact_shadows_replace_those_that_coarse_maps_lose(gl: rhi.Device) -> None:
    scene = make_boxes()
    fine = draw(gl, scene, ShadowSettings(cascades=1, cascade_size=2048, distance=4.0))
    coarse, both = (
        draw(gl, scene, settings) for settings in (replace(CONTACTS, contact_length=0.0), CONTACTS)
    )
    lost, left = (np.count_nonzero(np.abs(image - fine).max(axis=2) > 30) for image in (coarse, both))
    assert left < 0.6 * lost


@pytest.mark.nightly_cases(
    *(name for name in TECHNIQUES if name not in ("deferred", "inferred", "deferred_plus")),
    "cl*",
    "wgpu*",
    reason=FEWER_CASES,
)
@pytest.mark.parametrize("name", TECHNIQUES)
@pytest.mark.parametrize("points", [0, 2])
def test_all_techniques_draw_contact_shadows_alike(
    drawing_device: rhi.Device, name: str, points: int
) -> None:
    scene = make_boxes(points=points)
    expected, image = draw(drawing_device, scene, CONTACTS), draw(drawing_device, scene, CONTACTS, name)
    off = np.abs(expected - image).max(axis=2)
    # `inferred` lights at a part of the size.
    assert np.count_nonzero(off > 2) <= (0.02 * off.size if name == "inferred" else 0)
    assert np.abs(expected - draw(drawing_device, scene, replace(CONTACTS, contact_length=0.0))).max() > 40


def test_only_the_light_that_casts_shadows_is_blocked(gl: rhi.Device) -> None:
    # Of two suns the second casts shadows: the first one's light is as it was.
    scene = make_boxes(lights=2)
    contacts, plain = (
        draw(gl, scene, settings, light_component=LightComponent.SUN)
        for settings in (CONTACTS, replace(CONTACTS, contact_length=0.0))
    )
    assert (contacts <= plain).all()
    changed = np.abs(contacts - plain).max(axis=2) > 20
    assert changed.sum() > 30
    assert contacts[changed].min() > 60, "lit by the other sun"


def test_surfaces_behind_a_pane_are_shadowed_but_the_pane_is_not(gl: rhi.Device) -> None:
    # The pane is lit as if nothing was below it: its own part of the image stays the same.
    clear, glass = (
        [
            draw(gl, make_boxes(is_glass=is_glass), settings)
            for settings in (CONTACTS, replace(CONTACTS, contact_length=0.0))
        ]
        for is_glass in (False, True)
    )
    assert (np.abs(clear[0] - clear[1]).max(axis=2) > 20).sum() > 30
    darker = (glass[1] - glass[0]).max(axis=2)
    assert darker.min() >= -1
    assert 5 < darker.max() < (clear[1] - clear[0]).max()


def test_several_samples_have_contact_shadows(gl: rhi.Device) -> None:
    from renderer.techniques import ClusteredDeferred, Forward

    for technique in (Forward(samples=4), ClusteredDeferred(samples=4)):
        contacts, plain = (
            draw(gl, make_boxes(), settings, technique)
            for settings in (CONTACTS, replace(CONTACTS, contact_length=0.0))
        )
        assert (np.abs(contacts - plain).max(axis=2) > 20).sum() > 30


# -- what it costs


def record(scene: Scene, settings: ShadowSettings, technique: str, camera: Camera = EYE) -> list[Any]:
    """Return the commands of the third frame."""
    with open_device("null") as device:
        renderer = Renderer(device, scene, technique=technique, visibility="none", size=SIZE)
        renderer.shadows.settings = settings
        for _ in range(3):
            device.stream.clear()
            renderer.render(camera)
        return [(command.op, str(command)) for command in device.stream]


def list_passes(
    scene: Scene, settings: ShadowSettings, camera: Camera = EYE, technique: str = "forward"
) -> list[str]:
    with open_device("null") as device, Renderer(device, scene, technique=technique, size=SIZE) as renderer:
        renderer.shadows.settings = settings
        renderer.render(camera)
        return [part.name for part in renderer.plan(camera)[1].passes]


@pytest.mark.parametrize("technique", ["forward", "deferred", "forward_plus"])
def test_a_length_of_0_costs_nothing(technique: str) -> None:
    off = record(make_boxes(), replace(CONTACTS, contact_length=0.0, contact_steps=3), technique)
    assert off == record(make_boxes(), ShadowSettings(cascades=1, cascade_size=64, distance=20.0), technique)


@pytest.mark.parametrize(("technique", "more"), [("deferred", 1), ("forward_plus", 1), ("forward", 2)])
def test_rays_take_a_pass_and_depth_where_a_technique_draws_none(technique: str, more: int) -> None:
    passes = [
        sum(op is Op.BEGIN_PASS for op, _ in record(make_boxes(points=1), settings, technique))
        for settings in (replace(CONTACTS, contact_length=0.0), CONTACTS)
    ]
    assert passes[1] - passes[0] == more


@pytest.mark.parametrize(
    ("scene", "camera"),
    [
        (make_boxes(casts=False), EYE),
        (make_boxes(lights=0), EYE),
        (make_boxes(), Camera.look_at((0.0, 1.6, 9.0), (0.0, 3.0, 20.0))),
    ],
    ids=["no light casts shadows", "no directional light", "nothing in view"],
)
def test_where_nothing_can_be_shadowed_there_is_no_pass(scene: Scene, camera: Camera) -> None:
    assert "contact shadows" not in list_passes(scene, CONTACTS, camera)
    assert "contact shadows" in list_passes(make_boxes(), CONTACTS)


def test_a_component_without_the_sun_has_no_contact_shadows(null: rhi.Device) -> None:
    for component in LightComponent:
        with Renderer(null, make_boxes(), size=SIZE, light_component=component) as renderer:
            renderer.shadows.settings = CONTACTS
            renderer.render(EYE)
            enabled = renderer.plan(EYE)[0].enabled
        assert (Effect.CONTACT_SHADOWS in enabled) is (Effect.DIRECTIONAL_SHADOWS in enabled)


def test_the_plan_says_why(null: rhi.Device) -> None:
    with Renderer(null, make_boxes(), size=SIZE) as renderer:
        for length, reason in ((0.0, "length of contact shadows is 0"), (0.2, "directional light")):
            renderer.shadows.settings = replace(CONTACTS, contact_length=length)
            renderer.render(EYE)
            assert reason in renderer.plan(EYE)[0].explain(Effect.CONTACT_SHADOWS)


@pytest.mark.parametrize(
    "values",
    [
        {"contact_length": -0.1},
        {"contact_length": float("inf")},
        {"contact_steps": 0},
        {"contact_steps": 257},
        {"contact_rays": 0},
        {"contact_rays": 65},
        {"contact_thickness": 0.0},
        {"contact_thickness": float("nan")},
        {"contact_steps": 1.5},
    ],
)
def test_settings_out_of_range_are_refused(values: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match=BAD_SHADOWS.id):
        ShadowSettings(**values)


@pytest.mark.parametrize("values", [{"contact_length": 0.0}, {"contact_steps": 1}, {"contact_steps": 256}])
def test_settings_at_the_ends_of_their_ranges_are_taken(values: dict[str, Any]) -> None:
    assert ShadowSettings(**values)
