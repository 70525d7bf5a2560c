"""The device under mypy --strict: correct use passes, each mistake is refused on its line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from typing_kit import check_mistakes

DRAW = "device.draw(flat, mesh, tint=tint, many=many, albedo=image)"
MANY = "device.draw_many(flat, mesh, mesh.draws(), tint=tint, many=many, albedo=image)"

RIGHT = Path(__file__).with_name("device_right.py")
MISTAKES = [
    # a wrong state value
    ("CullMode.NONE, DepthWrite.OFF,", "CullMode.OFF, DepthWrite.OFF,", 'has no attribute "OFF"'),
    ("CullMode.NONE, DepthWrite.OFF,", '"none", DepthWrite.OFF,', 'Argument 1 to "states"'),
    ("ColorWrite.OFF.at(1)", "Format.R8", 'Argument 3 to "states"'),
    ("ColorWrite.OFF.at(1)", 'ColorWrite.OFF.at("1")', 'Argument 1 to "at"'),
    # a wrong kind of resource
    (DRAW, DRAW.replace("tint=tint", "tint=other"), 'expected "UniformRange[Tint] | Tint | dict[str, Any]"'),
    (DRAW, DRAW.replace("tint=tint", "tint=many"), 'expected "UniformRange[Tint] | Tint | dict[str, Any]"'),
    (DRAW, DRAW.replace("tint=tint", "tint=Other(color=(0, 0, 0, 0))"), 'has incompatible type "Other"'),
    (DRAW, DRAW.replace("albedo=image", "albedo=tint"), 'expected "TextureBinding"'),
    (DRAW, DRAW.replace("flat, mesh", "mesh, mesh"), 'Argument 1 to "draw"'),
    (DRAW, DRAW.replace("flat, mesh", "flat, image"), 'Argument 2 to "draw"'),
    (
        "flat.draw(mesh, 2, tint=objects[0]",
        "flat.draw(mesh, 2, tint=objects",
        'expected "UniformRange[Tint] | Tint | dict[str, Any]"',
    ),
    ("flat.draw(mesh, tint=objects[1], ", "flat.draw(mesh, ", 'Missing named argument "tint"'),
    ("device.render_pass(image", "device.render_pass(tint", 'Argument 1 to "render_pass"'),
    ("counted, [1], tint", "image, [1], tint", 'Argument 4 to "draw_counted"'),
    ("device.conditional(query)", "device.conditional(image)", 'Argument 1 to "conditional"'),
    # a missing or misspelt argument
    (DRAW, DRAW.replace(", albedo=image", ""), 'Missing named argument "albedo"'),
    (MANY, MANY.replace("tint=tint, ", ""), 'Missing named argument "tint"'),
    (MANY, MANY.replace("mesh.draws(), ", ""), "Too few arguments"),
    ("quads.vertex(position=(0, 0))", "quads.vortex(position=(0, 0))", 'has no attribute "vortex"'),
    (DRAW, DRAW.replace("many=many", "mny=many"), 'Unexpected keyword argument "mny"'),
    ("device.dispatch(plain, (1, 1, 1))", "device.dispatch(plain)", "Too few arguments"),
    # in a command buffer
    ("commands.draw(flat, mesh, 3", "commands.draw(flat, image, 3", 'Argument 2 to "draw"'),
    (
        "mesh, 3, tint=constants",
        "mesh, 3, tint=other",
        'expected "UniformRange[Tint] | Tint | dict[str, Any]"',
    ),
    ("device.submit(commands)", "device.submit(image)", 'expected "CommandBuffer"'),
    # a wrong value
    ("device.texture((8, 8), Format.RGBA8)", 'device.texture((8, 8), "rgba8")', 'Argument 2 to "texture"'),
    ("primitive=Primitive.QUADS", "primitive=4", 'Argument "primitive" to "mesh"'),
    ("Access.WRITE, 0, 2", '"w", 0, 2', 'Argument 1 to "lock"'),
    (
        "tint.write(Tint(color=(0, 0, 0, 0)))",
        "tint.write(Other(color=(0, 0, 0, 0)))",
        'Argument 1 to "write"',
    ),
    ("Tint(color=(1, 0, 0, 1))", "Tint(colour=(1, 0, 0, 1))", 'Unexpected keyword argument "colour"'),
    ("magnify=Filter.LINEAR", "magnify=True", 'Argument "magnify"'),
]


def test_right_use_passes_and_each_mistake_is_refused_on_its_line(
    mypy_strict: Callable[..., tuple[str, int]], tmp_path: Path
) -> None:
    check_mistakes(mypy_strict, tmp_path, RIGHT, MISTAKES)
