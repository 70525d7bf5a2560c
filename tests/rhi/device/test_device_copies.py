"""Nothing that belongs to a device is copied or pickled, alone or inside of something else."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import rhi
from rhi import Access, CullMode, Format, RhiError
from rhi.shading import Shader, Struct, Uniform, vec2, vec4


class Corner(Struct):
    position: vec2


class Tint(Struct):
    color: vec4


class Flat(Shader):
    tint: Uniform[Tint]

    def vertex(self, v: Corner) -> vec4:
        return vec4(v.position, 0.5, 1.0)

    def fragment(self) -> vec4:
        return self.tint.color


@dataclass
class Holder:
    """A class of a program that refers to a device's object."""

    thing: Any


POSITIONS = np.zeros((3, 2), np.float32)
OBJECTS: dict[str, Callable[[rhi.Device], Any]] = {
    "device": lambda d: d,
    "stream": lambda d: d.stream,
    "part of a stream": lambda d: d.stream[:],
    "texture": lambda d: d.texture((4, 4), Format.RGBA8),
    "view of a texture": lambda d: Holder(d.texture((4, 4), Format.RGBA8, levels=2).at(1)),
    "texture with a sampler": lambda d: Holder(
        d.texture((4, 4), Format.RGBA8).sampled(rhi.SamplerDescriptor())
    ),
    "buffer": lambda d: d.buffer(np.zeros(4, np.float32)),
    "uniform": lambda d: d.uniform(Tint(color=(1, 0, 0, 1))),
    "uniform array": lambda d: d.uniform_array(Tint, 3),
    "storage": lambda d: d.storage(float, 5),
    "mesh": lambda d: d.mesh({"position": POSITIONS}),
    "view of a mesh": lambda d: d.mesh({"position": POSITIONS}).view(0, 3),
    "program": lambda d: d.program(Flat),
    "command buffer": lambda d: d.record(),
    "scope": lambda d: d.states(CullMode.NONE),
    "pass": lambda d: d.render_pass(d.texture((4, 4), Format.RGBA8)),
    "event": lambda d: d.event("frame"),
    "query": lambda d: d.occlusion_query(),
    "lock": lambda d: d.buffer(np.zeros(4, np.float32)).lock(Access.READ),
    "readback": lambda d: d.texture((4, 4), Format.RGBA8).read_async(),
    "transient memory": lambda d: d.transient,
    "transient mesh": lambda d: d.transient.mesh(d.program(Flat), {"position": POSITIONS}),
    "preparation": lambda d: d.prepare(
        d.program(Flat), d.mesh({"position": POSITIONS}), targets=[Format.RGBA8]
    ),
}
COPIES: dict[str, Callable[[Any], object]] = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "deepcopy of a list": lambda thing: copy.deepcopy([1, {"key": thing}]),
    "deepcopy of an object": lambda thing: copy.deepcopy(Holder(thing)),
    **{f"pickle {i}": lambda thing, i=i: pickle.dumps(thing, i) for i in range(pickle.HIGHEST_PROTOCOL + 1)},
    "pickle of a list": lambda thing: pickle.dumps([thing]),
    "pickle of an object": lambda thing: pickle.dumps(Holder(thing)),
}


@pytest.fixture(scope="module")
def device() -> Iterator[rhi.Device]:
    with rhi.create_device("null") as opened:
        yield opened


@pytest.mark.parametrize("name", OBJECTS)
def test_objects_of_a_device_are_not_copied(name: str, device: rhi.Device) -> None:
    thing = OBJECTS[name](device)
    rules = {}
    for way, duplicate in COPIES.items():
        if way == "copy" and isinstance(thing, Holder):
            continue  # a shallow copy refers to the same thing
        try:
            duplicate(thing)
            rules[way] = ""
        except RhiError as error:
            rules[way] = error.rule.id
    assert rules == dict.fromkeys(rules, "device-copy")


def test_a_refused_copy_harms_nothing(device: rhi.Device) -> None:
    texture = device.texture((4, 4), Format.RGBA8)
    with pytest.raises(RhiError, match=r"(?s)device-copy.*Texture.*test_device_copies"):
        copy.copy(texture)
    assert texture.read().shape == (4, 4, 4)
    texture.destroy()


@pytest.mark.parametrize(
    "value",
    [
        Tint(color=(1.0, 0.0, 0.0, 1.0)), vec4(1.0), CullMode.NONE, rhi.Viewport(0, 0, 4, 4),
        rhi.BlendFunction(), Format.RGBA8, rhi.math.Perspective(),
    ],
)  # fmt: skip
def test_values_are_copied_and_pickled(value: object) -> None:
    """The control: what belongs to no device."""
    assert copy.copy(value) == copy.deepcopy(value) == pickle.loads(pickle.dumps(value)) == value
