"""Identifiers that become one name in a careless text stay apart in every language, whatever they name."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from clashing_names import FAMILIES, ComputeCase, DrawCase, compute_case, draw_case
from nights import rotate_seed

import rhi
import rhi.shading as sl
from rhi.backends.null import NullBackend
from rhi.contract.descriptors import Stage
from rhi.shading.glsl.glsl_names import RESERVED, VULKAN_RESERVED
from rhi.shading.glsl.spirv import find_tool
from rhi.shading.text.names import Names
from rhi.shading.wgsl.wgsl_names import RESERVED as WGSL_RESERVED

BACKENDS = ("gl", "cl", "wgpu", "null")
SOME = range(3)
MANY = range(100, 110)
NAMES = sorted({name for family in FAMILIES for name in family})


@pytest.fixture(scope="module", params=BACKENDS)
def running_device(request: pytest.FixtureRequest) -> Iterator[rhi.Device]:
    """A device of each backend; the null device runs compute shaders."""
    if request.param not in [backend.name for backend in rhi.report() if backend.usable]:
        pytest.skip(f"{request.param} doesn't work here")
    with rhi.create_device(request.param) as device:
        if request.param == "null":
            device.backend_as(NullBackend).run_shaders()
        yield device


def run_case(device: rhi.Device, case: ComputeCase) -> tuple[list[float], float]:
    """Run a compute shader; return what it writes to `out`, and the stored field."""
    shader, first, second = sl.from_source(case.text, "Reads", *case.structs)
    (_, b), values = case.fields, case.values
    inner = {name: first(**values(start)) for name, start in (("uniform", 30.0), ("storage", 60.0))}
    rows, others = np.zeros(1, first.dtype), np.zeros(1, second.dtype)
    for name, value in values(40.0).items():
        rows[name][..., : np.shape(value)[-1] if np.shape(value) else None] = value
    for name, value in values(60.0).items():
        others[b[1]][name][..., : np.shape(value)[-1] if np.shape(value) else None] = value
    others[b[0]] = 50.0
    bindings: dict[str, Any] = {
        case.uniforms[0]: first(**values(10.0)),
        case.uniforms[1]: second(**dict(zip(b, (20.0, inner["uniform"], 29.0), strict=True))),
        case.storages[0]: device.storage(first, rows),
        case.storages[1]: device.storage(second, others),
        "out": device.storage(float, len(case.expected)),
    }
    program: Any = device.program(shader)
    device.dispatch(program, 1, **bindings)
    written = bindings[case.storages[1]].read()[b[2]]
    return bindings["out"].read().tolist(), float(written[0])


@pytest.mark.parametrize("seed", [*SOME, *(pytest.param(n, marks=pytest.mark.nightly) for n in MANY)])
def test_each_thing_of_a_compute_shader_keeps_its_own_value(running_device: rhi.Device, seed: int) -> None:
    case = compute_case(rotate_seed(seed))
    assert run_case(running_device, case) == (case.expected, case.stored), case.text


def draw_targets(device: rhi.Device, case: DrawCase) -> list[list[float]]:
    """Draw one texel; return the color of each target."""
    shader = sl.from_source(case.text, "Draws")
    corners = [(-1.0, -1.0, 0.5, 1.0), (3.0, -1.0, 0.5, 1.0), (-1.0, 3.0, 0.5, 1.0)]
    formats: list[Any] = ["4f4", "f4", "2f4", "f4"]
    rows = np.zeros(3, [(name, form) for name, form in zip(case.attributes, formats, strict=True)])
    for name, value in zip(case.attributes, (corners, *case.ATTRIBUTES), strict=True):
        rows[name] = value
    textures = [device.texture(np.full((1, 1, 1), texel, "f4"), rhi.Format.R32F) for texel in case.TEXELS]
    targets = [device.texture((1, 1), rhi.Format.RGBA32F) for _ in case.outputs]
    bindings = dict(zip(case.uniforms, case.UNIFORMS, strict=True)) | dict(
        zip(case.textures, textures, strict=True)
    )
    program: Any = device.program(shader)
    with device.mesh(rows) as mesh, device.render_pass(targets):
        device.draw(program, mesh, **bindings)
    return [target.read().reshape(4).tolist() for target in targets]


@pytest.mark.parametrize("seed", [*SOME, *(pytest.param(n, marks=pytest.mark.nightly) for n in MANY)])
def test_each_attribute_varying_and_target_is_its_own(running_device: rhi.Device, seed: int) -> None:
    if running_device.backend_name == "null":
        pytest.skip("the null device draws nothing")
    case = draw_case(rotate_seed(seed))
    assert draw_targets(running_device, case) == [list(color) for color in case.EXPECTED], case.text


@pytest.mark.skipif(find_tool("glslangValidator") is None, reason="needs glslang")
@pytest.mark.parametrize("seed", range(6))
def test_glslang_takes_the_texts_for_vulkan(seed: int) -> None:
    shaders = [
        sl.from_source(compute_case(seed).text, "Reads"),
        sl.from_source(draw_case(seed).text, "Draws"),
    ]
    for program in map(sl.compile_shader, shaders):
        for stage in program.stages:
            assert program.emit("spirv", stage).binary


# -- numpy stages ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(12))
def test_stages_on_numpy_keep_each_attribute_and_varying(seed: int) -> None:
    case = draw_case(seed)
    shader = sl.from_source(case.text, "Draws")
    position, *others = case.attributes
    attributes = {position: (0.0, 0.0, 0.5, 1.0), **dict(zip(others, case.ATTRIBUTES, strict=True))}
    texels = [sl.HostTexture(np.full((1, 1), texel, "f4"), rhi.Format.R32F) for texel in case.TEXELS]
    textures: dict[str, Any] = dict(zip(case.textures, texels, strict=True))
    uniforms: dict[str, Any] = dict(zip(case.uniforms, case.UNIFORMS, strict=True))
    vertex = sl.run_vertex(shader, attributes, **uniforms, **textures)
    varyings = {
        name: np.broadcast_to(value, (1, 1, *np.shape(value))) for name, value in vertex.varyings.items()
    }
    fragment = sl.run_fragment(shader, varyings, **uniforms, **textures)
    drawn = [fragment.outputs[name].reshape(4).tolist() for name in case.outputs]
    assert drawn == [list(color) for color in case.EXPECTED], case.text


# -- names themselves --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "reserved", [RESERVED, VULKAN_RESERVED, WGSL_RESERVED], ids=["glsl", "vulkan", "wgsl"]
)
def test_different_names_stay_different_in_every_language(reserved: frozenset[str]) -> None:
    texts = Names(reserved=reserved).get_all({name: name for name in NAMES})
    assert len(set(texts)) == len(NAMES)
    assert not reserved & set(texts)
    assert all(re.fullmatch(r"[A-Za-z]\w*", text) and "__" not in text for text in texts)


def test_a_legal_name_is_unchanged_beside_a_name_that_is_mapped_onto_it() -> None:
    class Two(sl.Struct):
        a_: float
        a: float

    class Reads(sl.Shader):
        two: sl.Uniform[Two]
        out: sl.StorageRW[float]

        def compute(self) -> None:
            self.out[0] = self.two.a_ - self.two.a

    program = sl.compile_shader(Reads)
    for language in ("glsl", "vulkan", "wgsl"):
        assert "two.a_2 - two.a)" in program.emit(language, Stage.COMPUTE).text


def test_a_binding_has_one_name_in_both_stages() -> None:
    class Tinted(sl.Shader):
        u: sl.Uniform[sl.vec4]
        u_: sl.Uniform[sl.vec4]

        def vertex(self) -> sl.vec4:
            return self.u

        def fragment(self) -> sl.vec4:
            return self.u_

    program = sl.compile_shader(Tinted)
    assert "uniform u_block { vec4 u; }" in program.emit("glsl", Stage.VERTEX).text
    assert "uniform u_2_block { vec4 u_2; }" in program.emit("glsl", Stage.FRAGMENT).text


def test_constants_that_differ_in_the_sign_of_zero_are_two() -> None:
    text = """
from rhi.shading import Shader, StorageRW, function
class First:
    ROW = (0.0, 1.0)
class Second:
    ROW = (-0.0, 1.0)
class Reads(Shader):
    out: StorageRW[float]
    def compute(self) -> None:
        i = len(self.out) - 2
        self.out[0] = 1.0 / First.ROW[i]
        self.out[1] = 1.0 / Second.ROW[i]
"""
    program = sl.compile_shader(sl.from_source(text, "Reads"))
    for language in ("glsl", "wgsl"):
        assert len(re.findall("const .*ROW", program.emit(language, Stage.COMPUTE).text)) == 2
