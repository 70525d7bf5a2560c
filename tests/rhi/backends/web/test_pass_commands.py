"""The packed commands of a render pass, and the calls that JavaScript makes of them."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pytest
from nights import rotate_seed
from web_kit import run_in_node

from rhi.backends.web import pass_commands
from rhi.backends.web.pass_commands import REPLAY, ObjectTable, PassCommands

_PROGRAM = """
const make = () => {replay};
let replay = make();
let calls = [], released = 0, error = "", latest = 0;
const listen = (kind) => new Proxy({{}}, {{get: (_, method) => (...values) => {{
  const words = values.map((value) => value?.BYTES_PER_ELEMENT ? [...value] : value);
  if (method === "setBindGroup" && words.length > 2) words.splice(2, 3, words[2].slice(words[3], words[3] + words[4]));
  if (kind.calls) kind.calls.push([method, ...words]);
  else if (kind !== "device") calls.push([method, ...words]);
  if (method === {failing}) throw new Error("refused");
  if (method === "createRenderBundleEncoder") return listen({{calls: [], formats: values[0]}});
  if (method === "finish") return {{number: latest += 1, calls: kind.calls.slice(0, -1), formats: kind.formats}};
  return method.startsWith("begin") ? listen("pass") : undefined;
}}}});
const device = listen("device"), objects = new Map({objects}), description = {{formats: "the formats"}};
const results = {passes}.map((bytes) => {{
  const data = {{getBuffer: () => ({{data: Uint8Array.from(bytes), release() {{ released += 1; }}}})}};
  calls = [];
  if ({fresh}) replay = make();
  try {{ replay(device, listen("encoder"), description, data, objects); }} catch (each) {{ error = each.message; }}
  return calls;
}});
console.log(JSON.stringify([results, released, error]));
"""


def make_table() -> Any:
    """A table that stores its objects in a dictionary, `objects`."""
    objects: dict[int, Any] = {}
    table: Any = ObjectTable(objects.__setitem__, objects.__delitem__)
    table.objects = objects
    return table


_TABLE = make_table()
"""The table of most passes; the same object has the same number in all of them."""


def begin_pass(table: Any = _TABLE) -> PassCommands:
    return PassCommands(table, "encoder", "description")


def replay(*passes: PassCommands, failing: str = "", fresh: bool = False) -> tuple[list[list[Any]], int, str]:
    """The calls that JavaScript makes in each pass, how often it releases the array, and its error; `fresh`: it
    remembers no earlier pass."""
    node = run_in_node.find_node()
    if node is None:
        pytest.skip('no node: pip install "rhi[test]"')
    objects = {number: each for commands in passes for number, each in commands.table.objects.items()}  # type: ignore[attr-defined]
    program = _PROGRAM.format(
        replay=REPLAY,
        passes=[list(commands) for commands in passes],
        objects=json.dumps(list(objects.items())),
        failing=json.dumps(failing),
        fresh=json.dumps(fresh),
    )
    done = subprocess.run([node, "-"], input=program, capture_output=True, check=True, encoding="utf-8")
    calls, released, error = json.loads(done.stdout)
    return calls, released, error


def record() -> PassCommands:
    """A pass with one command of each kind."""
    render = begin_pass()
    pass_commands.set_pipeline(render, "pipeline")
    pass_commands.set_viewport(render, -1.5, 2.0, 30.0, 40.0, 0.25, 1.0)
    pass_commands.set_scissor_rect(render, 1, 2, 3, 4)
    pass_commands.set_blend_constant(render, (0.5, 0.25, 0.0, 1.0))
    pass_commands.set_stencil_reference(render, 7)
    pass_commands.set_bind_group(render, 0, "uniforms", 2, (256, 4294967040))
    pass_commands.set_bind_group(render, 1, "storage", 0, ())
    pass_commands.set_vertex_buffer(render, 3, "vertices", 64, 2**32 - 64)
    pass_commands.set_index_buffer(render, "indices", 1, 0, 96)
    pass_commands.begin_occlusion_query(render, 5)
    pass_commands.draw(render, 3, 2, 1, 9)
    pass_commands.draw_indexed(render, 6, 1, 2, -4, 8)
    pass_commands.end_occlusion_query(render)
    pass_commands.multi_draw_indirect(render, "arguments", 32, 2)
    pass_commands.multi_draw_indexed_indirect(render, "arguments", 40, 2)
    return render


def test_javascript_makes_the_calls_that_were_packed() -> None:
    (calls,), released, error = replay(record())
    assert (released, error) == (1, "")
    assert calls == [
        ["beginRenderPass", {"formats": "the formats"}],
        ["setPipeline", "pipeline"],
        ["setViewport", -1.5, 2, 30, 40, 0.25, 1],
        ["setScissorRect", 1, 2, 3, 4],
        ["setBlendConstant", [0.5, 0.25, 0, 1]],
        ["setStencilReference", 7],
        ["setBindGroup", 0, "uniforms", [256, 4294967040]],
        ["setBindGroup", 1, "storage"],
        ["setVertexBuffer", 3, "vertices", 64, 2**32 - 64],
        ["setIndexBuffer", "indices", "uint32", 0, 96],
        ["beginOcclusionQuery", 5],
        ["draw", 3, 2, 1, 9],
        ["drawIndexed", 6, 1, 2, -4, 8],
        ["endOcclusionQuery"],
        ["drawIndirect", "arguments", 32],
        ["drawIndirect", "arguments", 48],
        ["drawIndexedIndirect", "arguments", 40],
        ["drawIndexedIndirect", "arguments", 60],
        ["end"],
    ]


def test_a_pass_without_commands_begins_and_ends() -> None:
    (calls,), released, error = replay(begin_pass())
    assert ([call[0] for call in calls], released, error) == (["beginRenderPass", "end"], 1, "")


def test_a_pass_ends_although_a_call_is_refused() -> None:
    (calls,), released, error = replay(record(), failing="setScissorRect")
    assert [call[0] for call in calls] == [
        "beginRenderPass",
        "setPipeline",
        "setViewport",
        "setScissorRect",
        "end",
    ]
    assert (released, error) == (1, "refused")


def test_an_object_keeps_its_number_which_no_other_gets() -> None:
    first, second, third = ["buffer"], ["buffer"], ["buffer"]  # equal, and not the same
    table = make_table()
    render = begin_pass(table)
    assert [render.number(each) for each in (first, second, first)] == [1, 2, 1]
    table.forget(first)
    assert table.objects == {1: first, 2: second}  # commands of the pass may use it
    assert begin_pass(table).number(third) == 3
    assert table.objects == {2: second, 3: third}


# -- bundles -----------------------------------------------------------------------------------------------

MANY = 40
"""Draws of a pass that has at least one run."""


def bind_all(render: PassCommands) -> None:
    pass_commands.set_pipeline(render, "pipeline")
    pass_commands.set_viewport(render, 0.0, 0.0, 8.0, 8.0, 0.0, 1.0)
    pass_commands.set_vertex_buffer(render, 0, "vertices", 0, 64)


def record_draws(numbers: Iterable[int], more: int = 0) -> PassCommands:
    """A pass of draws, each with an offset of its own; with `more` ones before them."""
    render = begin_pass()
    bind_all(render)
    for number in range(more):
        pass_commands.draw(render, 6, 2 + number, 0, 0)
    for number in numbers:
        pass_commands.set_bind_group(render, 0, "uniforms", 1, (256 * number,))
        pass_commands.draw(render, 3, 1, 0, 0)
    return render


def count(calls: Sequence[Any], method: str) -> int:
    return sum(call[0] == method for call in calls)


def list_draws(calls: Sequence[Any]) -> list[Any]:
    """The draws of a pass in order, each with all that is bound and set then; those of bundles among them."""
    bound: dict[Any, Any] = {}
    states: dict[str, Any] = {}
    draws: list[Any] = []

    def follow(calls: Sequence[Any], bound: dict[Any, Any]) -> None:
        for method, *values in calls:
            if method.startswith("draw"):
                draws.append((method, values, dict(bound), dict(states)))
            elif method in ("setBindGroup", "setVertexBuffer"):
                bound[method, values[0]] = values
            elif method in ("setPipeline", "setIndexBuffer"):
                bound[method] = values
            elif method == "executeBundles":
                for bundle in values[0]:
                    follow(bundle["calls"], {})
                bound.clear()
            elif method not in ("beginRenderPass", "end"):
                states[method] = values

    follow(calls, bound)
    return draws


def test_draws_that_come_a_second_time_are_a_bundle_and_the_pass_sets_its_viewport() -> None:
    first, second, third = replay(*[record_draws(range(MANY))] * 3)[0]
    assert count(first, "executeBundles") == 0
    assert count(second, "executeBundles") == 1
    assert second == third
    assert ["setViewport", 0, 0, 8, 8, 0, 1] in second
    bundles = next(call[1] for call in second if call[0] == "executeBundles")
    assert {bundle["formats"] for bundle in bundles} == {"the formats"}
    assert bundles[0]["calls"][:2] == [["setPipeline", "pipeline"], ["setVertexBuffer", 0, "vertices", 0, 64]]
    assert list_draws(second) == list_draws(first)


def test_draws_of_an_earlier_pass_are_found_although_others_come_before_them() -> None:
    passes = [record_draws(range(400), more) for more in (0, 1, 2)]
    *_, last = replay(*passes)[0]
    bundled = [bundle for call in last if call[0] == "executeBundles" for bundle in call[1]]
    assert sum(count(bundle["calls"], "draw") for bundle in bundled) > 200
    assert list_draws(last) == list_draws(replay(passes[2], fresh=True)[0][0])


def test_short_passes_and_passes_that_differ_each_time_have_no_bundle() -> None:
    short = [record_draws(range(4))] * 4
    different = [record_draws(range(start, start + 4 * MANY)) for start in (0, 1000, 2000)]
    assert not any(count(calls, "executeBundles") for calls in replay(*short, *different)[0])


def record_randomly(numbers: np.random.Generator) -> PassCommands:
    """A pass of random commands, most of them bindings and draws."""
    render = begin_pass()
    bind_all(render)
    for _ in range(int(numbers.integers(1, 150))):
        kind, value = int(numbers.integers(30)), int(numbers.integers(3))
        name = "abc"[value]

        def named(kind: str, name: str = name) -> str:
            return sys.intern(f"{kind} {name}")

        match kind:
            case 0:
                pass_commands.set_pipeline(render, named("pipeline"))
            case 1:
                pass_commands.set_scissor_rect(render, value, 0, 8, 8)
            case 2:
                pass_commands.set_stencil_reference(render, value)
            case 3:
                pass_commands.set_blend_constant(render, (0.5 * value, 0.0, 0.0, 1.0))
            case 4 | 5:
                pass_commands.set_vertex_buffer(render, value, named("vertices"), 64 * value, 256)
            case 6:
                pass_commands.set_index_buffer(render, named("indices"), value % 2, 0, 96)
            case 7:
                pass_commands.multi_draw_indirect(render, named("arguments"), 16 * value, value)
            case 8:
                pass_commands.multi_draw_indexed_indirect(render, named("arguments"), 20 * value, value)
            case 9:
                pass_commands.set_bind_group(render, 1, named("textures"), 0, ())
            case 10 | 11 | 12 | 13:
                pass_commands.draw_indexed(render, 6, 1, 3 * value, -value, 0)
            case _:
                pass_commands.set_bind_group(render, 0, "uniforms", 2, (256 * value, 12))
                pass_commands.draw(render, 3, 1 + value, 0, 0)
    return render


def test_random_passes_make_the_draws_of_their_commands_after_any_others() -> None:
    """Passes of a pool come again and again, whole, or with another begin."""
    numbers = np.random.default_rng(rotate_seed(0))
    pool = [record_randomly(numbers) for _ in range(6)]
    passes = []
    for _ in range(60):
        commands = pool[numbers.integers(len(pool))]
        if numbers.random() < 0.5:
            longer = begin_pass()
            bind_all(longer)
            for number in range(int(numbers.integers(3))):
                pass_commands.draw(longer, 9, 1, number, 0)
            longer += commands
            commands = longer
        passes.append(commands)
    calls, released, error = replay(*passes)
    expected = replay(*passes, fresh=True)[0]
    assert (released, error) == (len(passes), "")
    assert sum(count(each, "executeBundles") for each in calls) > 20
    assert not any(count(each, "executeBundles") for each in expected)
    assert list(map(list_draws, calls)) == list(map(list_draws, expected))


@pytest.mark.parametrize("indexed", [False, True])
def test_a_draw_that_is_packed_in_advance_has_the_bytes_of_its_call(indexed: bool) -> None:
    render = begin_pass()
    if indexed:
        pass_commands.draw_indexed(render, 6, 1, 2, -4, 8)
    else:
        pass_commands.draw(render, 6, 1, 2, 8)
    assert pass_commands.pack_draw(indexed, 6, 2, -4, 8) == bytes(render)


def test_a_record_is_whole_words() -> None:
    assert np.frombuffer(record(), np.uint32).size * 4 == len(record())
