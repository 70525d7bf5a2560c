"""No assertion holds because of a slip: each function of `rhi.testing` refuses wrong arguments by name.

Every argument of every function gets every value that it can't be. Assertions then demand what is true of an
empty selection, so that one which takes the value passes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import rhi
from rhi import BlendFunction, CullMode, DepthBias, Format, Op, RhiError
from rhi.shading import Array, Shader, Struct, Uniform, array, vec2, vec4
from rhi.testing import (
    EffectPattern,
    assert_free,
    assert_same,
    assert_stream_matches,
    binding_data,
    count_work,
    expect,
    explain_invisible_draw,
    frames,
)
from rhi.testing.portability import check_portability

NAN, INF = float("nan"), float("inf")


class Corner(Struct):
    position: vec2


class Tint(Struct):
    color: vec4
    weights: Array[vec2] = array(vec2, 2)
    level: int = 0


class Flat(Shader):
    tint: Uniform[Tint]

    def vertex(self, v: Corner) -> vec4:
        return vec4(v.position, 0.5, 1.0)

    def fragment(self) -> vec4:
        return self.tint.color


@pytest.fixture(scope="module")
def device() -> Iterator[rhi.Device]:
    with rhi.create_device("null") as opened:
        image = opened.texture((8, 8), Format.RGBA8, label="image")
        mesh = opened.mesh({"position": np.zeros((3, 2), np.float32)}, label="triangle")
        tint = opened.uniform(Tint(color=(1, 0, 0, 1), weights=[(0, 0), (1, 1)]), label="tint")
        with (
            opened.event("view"),
            opened.render_pass(image, clear=(0, 0, 0, 1)),
            opened.states(CullMode.NONE),
        ):
            opened.draw(opened.program(Flat), mesh, tint=tint)
        opened.present(image)
        yield opened


NUMBERS = (NAN, INF, -1, 1.0, 0.5, "1", None, True, 1j, (1,), [], np.float64(2.0), np.zeros(2), Flat)
TOLERANCES = (NAN, INF, -0.1, "0", None, True, 1j, (0.1,), np.ma.masked)
NO_COMMANDS = (None, "abc", [], (), 3, Flat, object(), {"a": 1})
COLORS = ((), (1,), (1, 0), (1, 0, 0), (1, 0, 0, 1, 9), 1.0, (1, 0, 0, NAN), (1, 0, 0, INF), "red", None, (1j,) * 4,
          [[1, 0, 0, 1]], {1, 2, 3, 4}, Tint, np.zeros((2, 2)), (1, 0, 0, "1"))  # fmt: skip

Misuse = Callable[[rhi.Device, Any], object]


def none(device: rhi.Device) -> Any:
    """Draws, of which there is one."""
    return expect(device).draws()


MISUSES: dict[str, tuple[Misuse, tuple[Any, ...]]] = {
    "expect": (lambda d, v: expect(v), NO_COMMANDS),
    "frames": (lambda d, v: frames(v), NO_COMMANDS),
    "exactly": (lambda d, v: expect(d).draws(count=99).exactly(v), NUMBERS),
    "at_least": (lambda d, v: none(d).at_least(v), NUMBERS),
    "at_most": (lambda d, v: none(d).at_most(v), NUMBERS),
    **{
        f"costs {name}": (
            lambda d, v, n=name: none(d).costs(**{n: v}),
            tuple(n for n in NUMBERS if n is not None),
        )
        for name in (
            "max_draws",
            "max_dispatches",
            "max_hardware_state_changes",
            "max_upload_bytes",
            "max_creations",
        )
    },
    "before": (lambda d, v: none(d).before(v), (*NO_COMMANDS, expect(rhi.create_device("null")))),
    "draws program": (
        lambda d, v: expect(d).draws(program=v).exactly(0),
        (3.5, "", -1, 0, True, int, Corner, [], (), NAN),
    ),
    "dispatches program": (
        lambda d, v: expect(d).dispatches(program=v).exactly(0),
        (3.5, "", True, int, Corner, []),
    ),
    "draws arguments": (
        lambda d, v: expect(d).draws(**{v: 1}).exactly(0),
        ("progam", "instnces", "Count", "size", "x", "", "vertices"),
    ),
    "dispatches arguments": (
        lambda d, v: expect(d).dispatches(**{v: 1}).exactly(0),
        ("count", "X", "groups"),
    ),
    "commands arguments": (
        lambda d, v: expect(d).commands(Op.PRESENT, **{v: 1}).exactly(0),
        ("count", "image"),
    ),
    "narrowed arguments": (lambda d, v: expect(d).draws().commands(**{v: 1}).exactly(0), ("x", "text")),
    "draws count": (
        lambda d, v: expect(d).draws(count=v).exactly(0),
        (NAN, "3", 2.5, None, -3, (3,), True, Flat, object()),
    ),
    "draws primitive": (
        lambda d, v: expect(d).draws(primitive=v).exactly(0),
        ("TRIANGLES", 4, None, rhi.Primitive),
    ),
    "commands kinds": (lambda d, v: expect(d).commands(v).exactly(0), (None, "draw", 26, Op, [Op.DRAW])),
    "within": (lambda d, v: none(d).within(v).exactly(0), (None, 3, ["view"], b"view", NAN)),
    "within nothing": (lambda d, v: none(d).within(*v).exactly(1), ((),)),
    "states": (
        lambda d, v: none(d).with_states(*v).exactly(0),
        (
            (),
            ("CullMode.NONE",),
            (CullMode,),
            (None,),
            (3,),
            (CullMode.NONE, CullMode.BACK),
            ([CullMode.NONE],),
            (BlendFunction(), BlendFunction()),
        ),
    ),
    "states tolerance": (lambda d, v: none(d).with_states(DepthBias(5), tolerance=v).exactly(0), TOLERANCES),
    "bindings name": (
        lambda d, v: none(d).with_bindings(**{v: 3}).exactly(0),
        ("tnt", "Tint", "color", "tint_"),
    ),
    "bindings": (
        lambda d, v: none(d).with_bindings(tint=v).exactly(0),
        (3.5, None, [], "", 0, -1, NAN, True, Flat, (3,)),
    ),
    "bindings nothing": (lambda d, v: none(d).with_bindings(**v).exactly(1), ({},)),
    "data binding": (
        lambda d, v: none(d).with_data(v, {"color": (0, 0, 0, 0)}).exactly(0),
        ("tnt", "color", "", None, 3, Tint),
    ),
    "data field": (
        lambda d, v: none(d).with_data("tint", {v: 0}).exactly(0),
        ("colour", "", "color.4", "color.x", "weights.2.0", "weights.-1", "level.0", None, 3, "tint.level"),
    ),
    "data value": (lambda d, v: none(d).with_data("tint", {"color": v}).exactly(0), COLORS),
    "data of arrays": (
        lambda d, v: none(d).with_data("tint", {"weights": v}).exactly(0),
        ((0, 0), [(0, 0)], [(0, 0, 0)] * 2, [(0, 0)] * 3, [(0, 0), (NAN, 1)], 0.0),
    ),
    "data": (
        lambda d, v: none(d).with_data("tint", v).exactly(0),
        (None, 5, [], {}, "color", (1, 2), Corner),
    ),
    "data of another struct": (
        lambda d, v: none(d).with_data("tint", v).exactly(0),
        (Corner(position=(0, 0)),),
    ),
    "data tolerance": (
        lambda d, v: none(d).with_data("tint", {"color": (9, 9, 9, 9)}, tolerance=v).exactly(0),
        TOLERANCES,
    ),
    "of": (lambda d, v: none(d).of(v).exactly(0), (None, "fog", EffectPattern, EffectPattern("fog"), 3)),
    "where name": (lambda d, v: none(d).where(v, lambda _: False).exactly(0), (None, 3)),
    "where": (lambda d, v: none(d).where("large", v).exactly(0), (None, 3, "large", int, [])),
    "binding_data command": (lambda d, v: binding_data(v, "tint"), NO_COMMANDS),
    "binding_data name": (lambda d, v: binding_data(d.stream.draws()[0], v), (None, 3, ["tint"])),
    "explain": (lambda d, v: explain_invisible_draw(v), NO_COMMANDS),
    "count_work": (lambda d, v: count_work(v).__enter__(), NO_COMMANDS),
    **{
        f"pattern {name}": (
            lambda d, v, n=name: EffectPattern("fog", **{n: v}),
            ("fog", None, ["fog"], (3,), (None,), ("",), (int,)),
        )
        for name in ("programs", "words", "bindings", "resources", "events")
    },
    "pattern states": (
        lambda d, v: EffectPattern("fog", states=v),
        (CullMode.NONE, ("CullMode.NONE",), (CullMode,), []),
    ),
    "pattern ops": (lambda d, v: EffectPattern("fog", ops=v), (Op.DRAW, ("draw",), (26,), None)),
    "pattern where": (
        lambda d, v: EffectPattern("fog", where=v),
        (None, [], {"a": 3}, {3: print}, {"a": int}),
    ),
    "pattern name": (lambda d, v: EffectPattern(v), (None, 3, Flat)),
    "assert_free": (lambda d, v: assert_free(EffectPattern("fog", words=("fog",)), v), NO_COMMANDS),
    "assert_free effect": (lambda d, v: assert_free(v, d), (None, "fog", EffectPattern, 3)),
    "assert_free control": (
        lambda d, v: assert_free(EffectPattern("fog", words=("fog",)), d, control=v),
        tuple(v for v in NO_COMMANDS if v is not None),
    ),
    "assert_same": (lambda d, v: assert_same(d, v), NO_COMMANDS),
    "assert_same first": (lambda d, v: assert_same(v, d), NO_COMMANDS),
    "assert_same description": (lambda d, v: assert_same(d, d.stream[:1], description=v), (None, 3)),
    "assert_stream_matches": (
        lambda d, v: assert_stream_matches(v, "a.zip"),
        (*NO_COMMANDS, rhi.create_device("null")),
    ),
    "assert_stream_matches part": (
        lambda d, v: assert_stream_matches(v(d), "a.zip"),
        (lambda d: d.stream[:], lambda d: frames(d)[0], lambda d: d.stream.draws()),
    ),
    "assert_stream_matches file": (
        lambda d, v: assert_stream_matches(d, v),
        (None, 3, "", b"a.zip", ["a.zip"], Flat, "a\0b", ".", "/", __file__ + "/a.zip", "x" * 5000),
    ),
    "check_portability": (lambda d, v: check_portability(v), (None, 3, "frame", int, [])),
    "check_portability profiles": (
        lambda d, v: check_portability(lambda _: None, v),
        (None, {}, [], "gles-3", 3),
    ),
}
"""By name, a call with a value in the place of one argument, and values that this can't be."""


@pytest.mark.parametrize("name", MISUSES)
def test_a_wrong_argument_is_refused_by_name(name: str, device: rhi.Device) -> None:
    misuse, values = MISUSES[name]
    outcomes = []
    for value in values:
        try:
            misuse(device, value)
            outcomes.append((repr(value), "taken"))
        except RhiError as error:
            if error.rule.id != "assertion-argument":
                outcomes.append((repr(value), error.rule.id))
    assert outcomes == []


def test_commands_on_both_sides_are_two_streams(device: rhi.Device) -> None:
    with pytest.raises(RhiError, match="assertion-argument"):
        assert_same(device, device.stream)


def test_nothing_is_before_itself(device: rhi.Device) -> None:
    with pytest.raises(AssertionError, match="before all"):
        none(device).before(none(device))
    expect(device).commands(Op.BEGIN_PASS).before(none(device))


def test_without_a_program_a_misspelt_binding_is_not_refused() -> None:
    """Without a program there are no names, and no draws that could have them."""
    with rhi.create_device("null") as device:
        expect(device).draws().with_bindings(tint=3).exactly(0)


USES: dict[str, Callable[[rhi.Device], object]] = {
    "counts": lambda d: (none(d).exactly(1), none(d).at_least(np.int64(0)), none(d).at_most(1)),
    "programs": lambda d: (
        expect(d).draws(program=Flat).exactly(1),
        expect(d).draws(program="Flat").exactly(1),
        expect(d).draws(program="Shadow").exactly(0),
        expect(d).draws(program=d.program(Flat)).exactly(1),
    ),
    "arguments": lambda d: (
        expect(d).draws(count=3, instances=1).exactly(1),
        expect(d).draws(count=pytest.approx(3.1, abs=0.2)).exactly(1),
        expect(d).draws(draws=2).exactly(0),
        expect(d).draws(base_vertex=-1).exactly(0),
        expect(d).commands(Op.PUSH_LABEL, text="view").exactly(1),
        expect(d).draws(primitive=rhi.Primitive.TRIANGLES).exactly(1),
    ),
    "labels": lambda d: (none(d).within("view").exactly(1), none(d).within("sun").exactly(0)),
    "states": lambda d: (
        none(d).with_states(CullMode.NONE, rhi.DepthTest.ON).exactly(1),
        none(d).with_states(DepthBias(0.05), tolerance=0.1).exactly(1),
        none(d).with_states(BlendFunction(target=0), BlendFunction(target=1)).exactly(1),
    ),
    "bindings": lambda d: (
        none(d).with_bindings(tint="tint").exactly(1),
        none(d).with_bindings(tint="sky").exactly(0),
    ),
    "data": lambda d: (
        none(d).with_data("tint", {"color": (1, 0, 0, 1)}).exactly(1),
        none(d).with_data("tint", {"color": (0, 0, 0, 1)}).exactly(0),
        none(d).with_data("tint", {"color": np.array([0.9, 0, 0, 1])}, tolerance=0.2).exactly(1),
        none(d).with_data("tint", {"weights.1": (1, 1), "weights.0.1": 0, "level": 0}).exactly(1),
        none(d).with_data("tint", Tint(color=(1, 0, 0, 1), weights=[(0, 0), (1, 1)])).exactly(1),
    ),
    "costs": lambda d: (none(d).costs(max_draws=1), none(d).costs()),
    "patterns": lambda d: (
        assert_free(EffectPattern("fog", words=("fog",), states=(CullMode.FRONT,), ops=(Op.DISPATCH,)), d),
    ),
    "frames": lambda d: (frames(d), expect(frames(d.stream)[0]).draws().exactly(1)),
    "portability": lambda d: check_portability(lambda opened: opened.texture((4, 4), Format.RGBA8)),
}


@pytest.mark.parametrize("name", USES)
def test_right_arguments_are_taken(name: str, device: rhi.Device) -> None:
    USES[name](device)


def test_a_float_is_compared_as_the_shader_reads_it() -> None:
    with rhi.create_device("null") as device:
        image, mesh = (
            device.texture((8, 8), Format.RGBA8),
            device.mesh({"position": np.zeros((3, 2), np.float32)}),
        )
        with device.render_pass(image):
            tint = device.uniform(Tint(color=(0.1, 0.7, 1e-30, 1.0), weights=[(0, 0), (1, 1)]))
            device.draw(device.program(Flat), mesh, tint=tint)
        draws = expect(device).draws()
        draws.with_data("tint", {"color": (0.1, 0.7, 1e-30, 1.0)}).exactly(1)
        draws.with_data("tint", {"color": (0.1, 0.70001, 1e-30, 1.0)}).exactly(0)
