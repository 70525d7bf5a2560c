"""mypy --strict on shaders: correct code passes, and each mistake is reported on its line."""

from pathlib import Path

from typing_kit import check_mistakes

from rhi.shading.tools.stubs import stub_texts

DRAW = "device.draw(lit, None, light=light, lights=lights, counts=counts, albedo=texture, target=target)"

RIGHT = Path(__file__).with_name("shading_right.py")
MISTAKES = [
    (DRAW, DRAW.replace("albedo=texture, ", ""), 'Missing named argument "albedo"'),
    (DRAW, DRAW.replace("target=target", "targte=target"), 'Unexpected keyword argument "targte"'),
    (
        DRAW,
        DRAW.replace("light=light", "light=lights"),
        'incompatible type "StorageRange[Light]"; expected "UniformRange',
    ),
    (DRAW, DRAW.replace("lights=lights", "lights=counts"), 'incompatible type "StorageRange[uint]"'),
    (DRAW, DRAW.replace("albedo=texture", "albedo=target"), 'expected "TextureBinding"'),
    ("min(v.color, v.color.bgr), vec3", "v.color < v.color.bgr, bool", "Unsupported operand types for <"),
    ("min(ivec2(1, 2), ivec2(2, 1))", "min(mat4(1.0), mat4(2.0))", 'No overload variant of "min"'),
    ("self.light.position, vec3", "self.light.positoin, vec3", 'has no attribute "positoin"'),
    (
        "return Varying(clip=vec4(v.position, 0.5, 1.0), color=v.color,",
        "return Varying(clip=v.position, color=v.color,",
        'Argument "clip" to "Varying" has incompatible type "vec2"',
    ),
    ("color=v.color, id=uint(3)", "colour=v.color, id=uint(3)", 'Unexpected keyword argument "colour"'),
    ("v.position.yx, vec2", "v.position.zx, vec2", 'has no attribute "zx"'),
    ("v.color.rgb * 2.0", "v.color.rgb * v.position", "Unsupported operand types"),
    ("mat4(1.0) @ vec4", "mat3(1.0) @ vec4", 'No overload variant of "__matmul__" of "mat3"'),
    ("mix(v.color, vec3(1), 0.5)", "mix(v.color, vec2(1), 0.5)", "No overload variant"),
    ("self.albedo.sample(v.color.xy)", "self.albedo.sample(v.color)", "incompatible type"),
    ("self.albedo.sample(", "self.albedo.smaple(", 'has no attribute "smaple"'),
    (
        "lambert(normalize(v.color), self",
        "lambert(normalize(v.color.xy), self",
        'to "__call__" of "ShadingFunction"',
    ),
    ("self.counts[old] = 3", "self.counts[old] = 3.5", "No overload variant"),
    ("position=(0, 1, 0), power=1,", "position=(0, 1), power=1,", 'Argument "position" to "Light"'),
    ("position=(0, 1, 0), power=1,", "power=1,", 'Missing named argument "position"'),
    ("value.position = (1, 2, 3)", "value.position = (1, 2)", "Incompatible types in assignment"),
]


def test_right_shaders_pass_and_each_mistake_is_refused_on_its_line(mypy_strict, tmp_path):
    check_mistakes(mypy_strict, tmp_path, RIGHT, MISTAKES)


def test_the_stubs_are_generated_from_the_tables():
    for path, text in stub_texts().items():
        assert path.read_text(encoding="utf-8") == text, (
            f"run python -m rhi.shading.tools.stubs ({path.name})"
        )
