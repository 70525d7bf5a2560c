"""Spheres of materials that have everything a material may have."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.content import BUILT_IN
from renderer.scene import (
    AlphaMode,
    Camera,
    Scene,
    SceneBuilder,
    TextureMap,
    make_geometry,
    scaling,
    translation,
)
from rhi import SamplerDescriptor, Wrap

MIRRORED = SamplerDescriptor(wrap_u=Wrap.MIRROR, wrap_v=Wrap.CLAMP)


def make_noise(size: tuple[int, int], seed: int, low: int = 0, high: int = 255) -> NDArray[np.uint8]:
    """Return an image of random blocks of 4 × 4 texels, opaque."""
    width, height = size
    blocks = np.random.default_rng(seed).integers(
        low, high + 1, (-(-height // 4), -(-width // 4), 4), np.uint8
    )
    image = blocks.repeat(4, axis=0).repeat(4, axis=1)[:height, :width]
    image[..., 3] = 255
    return np.ascontiguousarray(image)


def build_materials(*, lights: bool = True, seed: int = 3) -> Scene:
    """Build nine spheres before a wall: metals, dielectrics and specular materials, with and without maps, a
    mask, two sides, mirrored transforms, and images of four sizes, one of them a single texel."""
    random = np.random.default_rng(seed)
    builder = SceneBuilder("materials")
    bumps = make_noise((64, 64), 5, 96, 160)
    bumps[..., 2], bumps[:8, :8, :3] = 230, 128  # without a direction
    holes = make_noise((32, 32), 6)
    holes[..., 3] = 255 * random.integers(0, 2, (32, 32))
    images = [
        make_noise((64, 64), 1, 40),
        make_noise((16, 32), 2),
        make_noise((16, 16), 3),
        make_noise((1, 1), 4),
    ]
    base, rough, occlusion, emissive, normal, mask = (
        builder.add_image(image) for image in (*images, bumps, holes)
    )
    parameters: list[dict[str, Any]] = [
        {"base_color": (0.9, 0.6, 0.3), "metallic": 1.0, "roughness": 0.0},
        {"base_color": (0.9, 0.6, 0.3), "metallic": 1.0, "roughness": 0.4},
        {"base_color": (0.2, 0.5, 0.9), "metallic": 0.0, "roughness": 0.25},
        {
            "texture": base,
            "metallic_roughness_texture": TextureMap(rough, scale=(3.0, 2.0), rotation=0.4),
            "normal_texture": normal,
            "normal_scale": 1.5,
            "occlusion_texture": TextureMap(occlusion, uv_set=1),
            "emissive": (0.4, 0.2, 0.1),
            "emissive_texture": emissive,
        },
        {
            "texture": TextureMap(base, scale=(2, 2), offset=(-0.25, 1000.3), sampler=MIRRORED),
            "roughness": 0.5,
            "metallic": 0.2,
        },
        {
            "base_color": (0.7, 0.2, 0.2),
            "specular_color": (0.4, 0.4, 0.4),
            "shininess": 60,
            "rim_strength": 0.3,
        },
        {"texture": base, "normal_texture": normal, "emission": 0.2},
        {"texture": mask, "alpha_mode": AlphaMode.MASK, "double_sided": True},
        {"base_color": (0.9, 0.9, 0.9), "roughness": 1.0, "metallic": 0.5},
    ]
    materials = [builder.add_material(**values) for values in parameters]
    sphere = BUILT_IN["sphere"]().vertices
    colors = np.append(random.uniform(0.5, 1.0, (len(sphere), 3)), np.ones((len(sphere), 1)), axis=1)
    geometry = make_geometry(
        sphere["position"],
        BUILT_IN["sphere"]().indices,
        sphere["normal"],
        sphere["uv"] * (4, 2),
        uv2=sphere["uv"] * 3,
        color=colors,
    )
    ball = builder.add_mesh(geometry)
    for number, material in enumerate(materials):
        position = translation((1.3 * (number % 3 - 1), 1.3 * (number // 3 - 1), 0.0))
        sides = scaling((-1 if number in (3, 7) else 1, 1, 1))
        builder.add_objects(builder.add_node(position @ sides), ball, material)
    wall = translation((0, 0, -1.2)) @ scaling((6, 6, 0.1))
    builder.add_objects(builder.add_node(wall), builder.add_mesh(BUILT_IN["box"]()), materials[8])
    builder.lights.add_directional((-0.5, -0.7, -0.6), (1, 0.95, 0.9), 1.2)
    for _ in range(12 if lights else 0):
        builder.lights.add_point(
            random.uniform((-2, -2, 0.6), (2, 2, 1.6)), 1.6, random.uniform(0.2, 1, 3), 0.7
        )
    for _ in range(4 if lights else 0):
        position = random.uniform((-2, -2, 1.5), (2, 2, 2))
        builder.lights.add_spot(position, (0, 0, -1), 4.0, 0.3, 0.6, random.uniform(0.2, 1, 3), 3.0)
    builder.lights.sky, builder.lights.ground = (0.3, 0.35, 0.4), (0.15, 0.14, 0.12)
    builder.views["front"] = Camera.look_at((0.4, 0.5, 5.0), (0, 0, 0))
    return builder.build()
