"""Particles with materials, compared with rays in float64.

Copies of a mesh are where a simulation says, turned by its quaternions or to the eye. The reference is a still scene in
which each particle is an object of its own, with a transform of matrices.
"""

from __future__ import annotations

from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from renderer.content import BUILT_IN
from renderer.lab.exam.case import CaseImage, CaseResult, Measures, largest_error
from renderer.lab.exam.ray_traced_cases import TracedImage, draw, trace_image
from renderer.lab.exam.scenes import shows_something
from renderer.scene import (
    AlphaMode,
    Camera,
    Fog,
    MeshGeometry,
    Orthographic,
    Perspective,
    Recompute,
    Scene,
    SceneBuilder,
    TextureMap,
)
from renderer.scene.arrays import Floats, Indices
from renderer.scene.particles import MeshParticles, ParticlePoses, make_quad
from rhi import Device, SamplerDescriptor
from rhi.math import multiply, rotation, scaling, translation

_SIZE: Final = (96, 64)
_COUNT: Final = 24
_SEED: Final = 12
_UNBLURRED: Final = SamplerDescriptor(mip=None)


class ParticleView(NamedTuple):
    """A view: the technique that draws it, the particles' mesh and material, whether they face the eye, whether the
    eye is far away, the metres from the origin along each axis, and whether there is fog."""

    technique: str
    mesh: str
    material: dict[str, Any]
    faces_eye: bool = False
    is_parallel: bool = False
    offset: float = 0.0
    has_fog: bool = False


_GREY: Final = {"base_color": (0.6, 0.5, 0.4)}
_SMOKE: Final = {"base_color": (0.7, 0.75, 0.8, 0.6), "alpha_mode": AlphaMode.BLEND}
_LEAF: Final = {"alpha_mode": AlphaMode.MASK, "double_sided": True, "roughness": 0.7, "metallic": 0.0}
_FOIL: Final = {"base_color": (0.8, 0.6, 0.4), "metallic": 0.6, "roughness": 0.5, "double_sided": True}
_VIEWS: Final = {
    "boxes, object by object": ParticleView("forward", "box", _GREY),
    "leaves with holes, by volumes of lights": ParticleView("deferred", "leaf", _LEAF),
    "smoke that faces the eye, in fog": ParticleView(
        "forward_plus", "quad", _SMOKE, faces_eye=True, has_fog=True
    ),
    "glass splinters over each other": ParticleView("clustered", "quad", _SMOKE | {"double_sided": True}),
    "foil with a normal map, 10⁵ m away": ParticleView("deferred_plus", "foil", _FOIL, offset=1e5),
    "cards that face a parallel eye": ParticleView("tiled_deferred", "leaf", _LEAF, True, is_parallel=True),
}
_EYE: Final = Camera.look_at((0.4, 0.9, 2.9), (0.0, 0.0, 0.0), projection=Perspective(0.9, 1.5))
_ABOVE: Final = Camera.look_at(
    (1.0, 4.0, 2.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), Orthographic(3.4, 1.5, 0.1, 9.0)
)


class CardPoses(NamedTuple):
    """The particles of a view: positions (n, 3), sizes (n,), and the unit axes (n, 3) and angles (n,) of turns."""

    position: Floats
    size: Floats
    axis: Floats
    angle: Floats


class CardSimulation(MeshParticles):
    """Particles that stay where they are."""

    def __init__(self, poses: CardPoses, geometry: MeshGeometry, *, faces_eye: bool) -> None:
        self.catch_up = Recompute()
        self._poses = poses
        super().__init__(1, len(poses.size), geometry, faces_eye=faces_eye)

    def set_time(self, members: Indices, seconds: float) -> None:
        """Change nothing: particles rest."""

    def pose(self, members: Indices) -> ParticlePoses:
        """Return the particles of the only member."""
        position, size, axis, angle = self._poses
        half = 0.5 * angle[:, None]
        rotations = np.concatenate([axis * np.sin(half), np.cos(half)], axis=1)
        return ParticlePoses(position[None], size[None], rotations[None])


def make_poses(*, faces_eye: bool) -> CardPoses:
    """Make particles around the origin, turned at random, none of which reaches into another."""
    random = np.random.default_rng(_SEED)
    cells = np.stack(np.unravel_index(random.permutation(_COUNT), (4, 3, 2)), axis=1)
    position = (cells - (1.5, 1.0, 0.5)) * (0.72, 0.68, 1.1) + random.uniform(-0.06, 0.06, (_COUNT, 3))
    axis = random.normal(size=(_COUNT, 3))
    if faces_eye:
        axis[:] = (0.0, 0.0, 1.0)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    return CardPoses(position, random.uniform(0.4, 0.5, _COUNT), axis, random.uniform(-3.0, 3.0, _COUNT))


def face_eye(positions: Floats, camera: Camera) -> Floats:
    """Return transforms (n, 4, 4) that turn +z to the eye, and +y into the plane of the eye and the vertical."""
    is_parallel = isinstance(camera.projection, Orthographic)
    away = (
        np.broadcast_to(camera.rotation[2], positions.shape) if is_parallel else camera.position - positions
    )
    front = away / np.linalg.norm(away, axis=1, keepdims=True)
    right = np.cross((0.0, 1.0, 0.0), front)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    turns = np.tile(np.eye(4), (len(positions), 1, 1))
    turns[:, :3, :3] = np.stack([right, np.cross(front, right), front], axis=2)
    return turns


def make_image(kind: str) -> CaseImage:
    """Make the image (16, 16, 4) of a material: a leaf with holes, or normals of waves."""
    y, x = np.mgrid[:16, :16] / 15.0
    if kind == "foil":
        slope = 0.35 * np.sin(6.0 * x + 2.0 * y)
        return np.asarray(
            np.round(
                255.0 * np.stack([0.5 + slope, 0.5 - 0.5 * slope, 0.9 + 0.0 * x, 1.0 + 0.0 * x], axis=-1)
            ),
            np.uint8,
        )
    alpha = 1.2 - 1.6 * np.abs(x - 0.5) - 1.2 * (y - 0.4) ** 2
    channels = 0.3 + 0.4 * x, 0.5 + 0.3 * y, 0.2 + 0.2 * x * y, np.clip(alpha, 0.0, 1.0)
    return np.asarray(np.round(255.0 * np.stack(channels, axis=-1)), np.uint8)


def make_view(view: ParticleView, *, as_objects: bool) -> tuple[Scene, Camera]:
    """Make a view's scene and its camera, with particles or with an object for each."""
    builder, offset = SceneBuilder("particles"), np.full(3, view.offset)
    camera = _ABOVE if view.is_parallel else _EYE
    poses = make_poses(faces_eye=view.faces_eye)
    geometry = BUILT_IN["box"]() if view.mesh == "box" else make_quad(1.0, 0.7)
    values = dict(view.material)
    if view.mesh == "leaf":
        values["texture"] = TextureMap(builder.add_image(make_image("leaf")), sampler=_UNBLURRED)
    if view.mesh == "foil":
        values["normal_texture"] = TextureMap(builder.add_image(make_image("foil")), sampler=_UNBLURRED)
    material = builder.add_material(**values)
    if as_objects:
        turns = np.array([rotation(axis, angle) for axis, angle in zip(poses.axis, poses.angle, strict=True)])
        if view.faces_eye:
            turns = multiply(face_eye(poses.position, camera), turns)
        scales = scaling(poses.size[:, None] * np.ones(3))
        matrices = multiply(multiply(translation(poses.position + offset), turns), scales)
        builder.add_objects(builder.add_nodes(matrices), builder.add_mesh(geometry), material)
    else:
        simulation = CardSimulation(poses, geometry, faces_eye=view.faces_eye)
        bounds = (np.full(3, -2.5), np.full(3, 2.5))
        mesh = builder.add_mesh(simulation.make_mesh(), bounds=bounds)
        builder.simulate(
            builder.add_objects(builder.add_node(translation(offset)), mesh, material), simulation
        )
    wall = builder.add_material(base_color=(0.35, 0.4, 0.5))
    back = builder.add_node(
        multiply(translation(np.add(offset, (0.0, 0.0, -2.6))), scaling((12.0, 12.0, 0.2)))
    )
    builder.add_objects(back, builder.add_mesh(BUILT_IN["box"]()), wall)
    builder.lights.sky, builder.lights.ground = (0.25, 0.28, 0.32), (0.2, 0.16, 0.12)
    builder.lights.add_directional((0.3, -0.6, -1.0), intensity=0.8)
    builder.lights.add_point(np.add(offset, (1.0, 1.5, 2.0)), 9.0, intensity=3.0)
    if view.has_fog:
        builder.fog = Fog(0.12, (0.5, 0.55, 0.6), 0.0, 100.0)
    return builder.build(), Camera(camera.position + offset, camera.rotation, camera.projection)


@cache  # the same for each device
def trace_view(title: str) -> TracedImage:
    """The ray-traced image of a view, of objects."""
    return trace_image(*make_view(_VIEWS[title]._replace(offset=0.0), as_objects=True), _SIZE)


def measure_particles(device: Device) -> CaseResult:
    """Draw views, and measure by how many levels pixels are out of the bounds that rays have there."""
    numbers, holds, images = dict[str, object](), dict[str, bool](), dict[str, CaseImage]()
    error = 0.0
    for title, view in _VIEWS.items():
        traced = trace_view(title)
        scene, camera = make_view(view, as_objects=False)
        image: NDArray[Any] = draw(device, scene, camera, _SIZE, technique=view.technique, seconds=0.5)
        levels = image[..., :3].astype(np.float64)
        off = np.maximum(traced.low - levels, levels - traced.high).max(axis=2)
        off = np.where(traced.is_smooth, np.maximum(off, 0.0), 0.0)
        numbers[f"{title}: levels off"] = round(float(off.max()), 3)
        numbers[f"{title}: pixels compared"] = int(traced.is_smooth.sum())
        error = largest_error(error, float(off.max()))
        holds |= {f"{title}: {text}": is_true for text, is_true in shows_something([image]).items()}
        holds[f"{title}: most pixels are compared"] = bool(traced.is_smooth.mean() > 0.5)
        images |= {title: image, f"{title}, off": off, f"{title}, by rays": traced.levels.astype(np.uint8)}
    return CaseResult(error, numbers, holds, lambda: images)


MEASURES: Final[Measures] = {102: measure_particles}
