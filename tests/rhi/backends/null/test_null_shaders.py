"""Shaders on the null device: dispatches on NumPy, and stand-ins for fragments."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from harness_kit import Corner

import rhi
import rhi.shading as sl
from rhi import Format, IndirectDraws
from rhi.backends.null import NullBackend, Simulation
from rhi.errors import ShaderError


class Scale(sl.Struct):
    factor: float


class Item(sl.Struct):
    position: sl.vec3
    weight: float


class Weigh(sl.Shader):
    work_group = (4,)
    scale: sl.Uniform[Scale]
    items: sl.Storage[Item]
    weights: sl.StorageRW[float]

    def compute(self) -> None:
        i = sl.global_id().x
        if i < len(self.weights):
            self.weights[i] += self.scale.factor * self.items[i].weight * self.items[i].position.z


class Brighten(sl.Shader):
    source: sl.Texture2D
    target: sl.Image2D = sl.image(Format.RGBA8)

    def compute(self) -> None:
        at = sl.ivec2(sl.global_id().xy)
        self.target.store(at, self.source.load(at) + sl.vec4(0.0, 1.0, 0.0, 0.0))


class Careless(sl.Shader):
    checked = True
    weights: sl.StorageRW[float]

    def compute(self) -> None:
        self.weights[sl.global_id().x + 7] = 1.0


class Mark(sl.Shader):
    marks: sl.StorageRW[sl.uint]

    def vertex(self, v: Corner) -> sl.vec4:
        return sl.vec4(v.position + float(sl.instance_index()), 0.5, 1.0)

    def fragment(self) -> None:
        self.marks[0] = sl.uint(1)


@pytest.fixture(params=[None, Simulation()], ids=["plain", "simulated"])
def device(request: pytest.FixtureRequest) -> Iterator[rhi.Device]:
    with rhi.create_device("null", simulation=request.param) as created:
        yield created


def weigh(device: rhi.Device, count: int = 6) -> np.ndarray:
    """Return the result of two dispatches of `Weigh` with weights of 1."""
    items = np.zeros(count, Item.dtype)
    items["position"][:, 2], items["weight"] = np.arange(count), 2.0
    weights = device.storage(float, np.ones(count, np.float32))
    program, scales = device.program(Weigh), device.uniform_array(Scale, 2)
    factors = np.zeros(2, scales.dtype)
    factors["factor"] = 3.0, 5.0
    scales.write(factors)
    for row in range(2):
        device.dispatch(
            program, -(-count // 4), scale=scales[row], items=device.storage(Item, items), weights=weights
        )
    return weights.read()


def test_dispatches_run_when_asked_to(device: rhi.Device) -> None:
    assert weigh(device).tolist() == [1.0] * 6, "the control: nothing runs"
    device.backend_as(NullBackend).run_shaders()
    assert weigh(device).tolist() == [1.0 + 16.0 * i for i in range(6)]
    assert not device.capabilities.shading


def test_shaders_run_with_bindings_made_before_they_were_switched_on(device: rhi.Device) -> None:
    weights = device.storage(float, np.ones(4, np.float32))
    arguments = {
        "scale": device.uniform(Scale(factor=1.0)),
        "items": device.storage(Item, np.ones(4, Item.dtype)),
        "weights": weights,
    }
    program = device.program(Weigh)
    device.dispatch(program, 1, **arguments)
    device.finish()
    device.backend_as(NullBackend).run_shaders()
    device.dispatch(program, 1, **arguments)
    assert weights.read().tolist() == [2.0] * 4


def test_an_indirect_dispatch_runs_as_many_groups_as_memory_says(device: rhi.Device) -> None:
    device.backend_as(NullBackend).run_shaders()
    weights = device.storage(float, np.zeros(12, np.float32))
    items = device.storage(Item, np.ones(12, Item.dtype))
    groups = device.storage(sl.uint, np.array([2, 1, 1, 0], np.uint32))
    device.dispatch_indirect(
        device.program(Weigh), groups, scale=device.uniform(Scale(factor=1.0)), items=items, weights=weights
    )
    assert weights.read().tolist() == [1.0] * 8 + [0.0] * 4


def test_textures_are_read_and_images_written(device: rhi.Device) -> None:
    device.backend_as(NullBackend).run_shaders()
    texels = np.zeros((2, 3, 4), np.uint8)
    texels[1, 2] = 255, 0, 7, 9
    source, target = device.texture(texels, Format.RGBA8), device.texture((3, 2), Format.RGBA8)
    device.dispatch(device.program(Brighten), (3, 2), source=source, target=target.image())
    expected = texels.copy()
    expected[..., 1] = 255
    assert (target.read() == expected).all()


def test_a_fault_of_a_checked_shader_is_raised(device: rhi.Device) -> None:
    device.backend_as(NullBackend).run_shaders()
    weights = device.storage(float, 4)
    device.dispatch(device.program(Careless), 1, weights=weights)
    with pytest.raises(ShaderError, match=r"^\[shading-index\]"):
        weights.read()


def draw_thrice(device: rhi.Device, marks: rhi.StorageBuffer[sl.uint]) -> None:
    """Draw three instances directly, then 1 and 2 instances indirectly."""
    mark, image = device.program(Mark), device.texture((8, 8), Format.RGBA8)
    mesh = device.mesh({"position": np.zeros((3, 2), np.float32)})
    draws = mesh.draws(instances=[1, 2], base_instance=[5, 9])
    with device.render_pass(image):
        device.draw(mark, mesh, 3, marks=marks)
        device.draw_indirect(mark, mesh, IndirectDraws(device.buffer(draws), 2), marks=marks)


def test_a_stand_in_function_runs_for_each_draw_in_place_of_its_fragments(device: rhi.Device) -> None:
    seen = []

    def mark(bound, draw):
        seen.append((draw.base_instance, draw.instances))
        bound["marks"][draw.base_instance :][: draw.instances] = 1

    marks = device.storage(sl.uint, 12)
    device.backend_as(NullBackend).run_shaders({device.program(Mark).id: mark})
    draw_thrice(device, marks)
    assert np.flatnonzero(marks.read()).tolist() == [0, 1, 2, 5, 9, 10]
    assert seen == [(0, 3), (5, 1), (9, 2)]
    assert device.backend_as(NullBackend).statistics.draws == 3


def test_a_draw_that_a_condition_drops_does_nothing(device: rhi.Device) -> None:
    null, marks, query = device.backend_as(NullBackend), device.storage(sl.uint, 12), device.occlusion_query()
    null.run_shaders({device.program(Mark).id: lambda bound, draw: bound["marks"].fill(1)})
    null.count_samples(lambda draw: 0)
    with device.render_pass(device.texture((8, 8), Format.RGBA8)), query:
        pass
    mark, mesh = device.program(Mark), device.mesh({"position": np.zeros((3, 2), np.float32)})
    with device.render_pass(device.texture((8, 8), Format.RGBA8)), device.conditional(query):
        device.draw(mark, mesh, marks=marks)
    assert not marks.read().any()


def test_samples_are_counted_whoever_stands_in(device: rhi.Device) -> None:
    null, marks, query = device.backend_as(NullBackend), device.storage(sl.uint, 12), device.occlusion_query()
    null.run_shaders({device.program(Mark).id: lambda bound, draw: None})
    null.count_samples(lambda draw: 10 * draw.instances)
    mark, mesh = device.program(Mark), device.mesh({"position": np.zeros((3, 2), np.float32)})
    with device.render_pass(device.texture((8, 8), Format.RGBA8)), query:
        device.draw(mark, mesh, 4, marks=marks)
    assert query.wait() == 40


def test_a_stand_in_goes_before_numpy(device: rhi.Device) -> None:
    def weigh_all(bound, draw):
        assert draw is None
        assert bound["items"]["weight"].tolist() == [2.0] * 6
        bound["weights"] += bound["scale"]["factor"][0]

    device.backend_as(NullBackend).run_shaders({device.program(Weigh).id: weigh_all})
    assert weigh(device).tolist() == [9.0] * 6
