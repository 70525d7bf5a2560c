"""The packed commands of a render pass, and the calls that JavaScript makes of them."""

from __future__ import annotations

import itertools
import json
import subprocess
from typing import Any

import numpy as np
import pytest
from web_kit import run_in_node

from rhi.backends.web import pass_commands
from rhi.backends.web.pass_commands import (
    LEAST_BUNDLED,
    MAX_BUNDLES,
    REPLAY,
    BundleCache,
    ObjectTable,
    PassCommands,
)

_PROGRAM = """
const {{replay, bundle}} = {replay};
const calls = [];
const listen = (name) => new Proxy({{}}, {{get: (_, method) => (...values) => {{
  calls.push([method, ...values.map((value) => value?.BYTES_PER_ELEMENT ? [...value] : value)]);
  if (method === {failing}) throw new Error("refused");
  if (method === "finish") return "the bundle";
  return method.startsWith("begin") || method.startsWith("create") ? listen("pass") : undefined;
}}}});
const bytes = Uint8Array.from({data});
let released = 0, error = "";
const data = {{getBuffer: () => ({{data: bytes, release() {{ released += 1; }}}})}};
const objects = new Map({objects}), description = {{formats: "the formats"}};
try {{
  const bundled = {bundles} && bundle(listen("device"), description, data, objects);
  replay(listen("encoder"), "description", data, objects, bundled);
}} catch (each) {{ error = each.message; }}
console.log(JSON.stringify([calls, released, error]));
"""


def begin_pass() -> PassCommands:
    """A pass whose table stores its objects in a dictionary, `table.objects`."""
    objects: dict[int, Any] = {}
    table: Any = ObjectTable(objects.__setitem__, objects.__delitem__)
    table.objects = objects
    return PassCommands(table, "encoder", "description")


def replay(commands: PassCommands, failing: str = "", *, bundles: bool = False) -> tuple[list[Any], int, str]:
    """The calls that JavaScript makes, how often it releases the array, and its error; `bundles`: after it has made a
    bundle of the commands."""
    node = run_in_node.find_node()
    if node is None:
        pytest.skip('no node: pip install "rhi[test]"')
    program = _PROGRAM.format(
        replay=REPLAY,
        data=list(commands),
        objects=json.dumps(list(commands.table.objects.items())),  # type: ignore[attr-defined]
        bundles=json.dumps(bundles),
        failing=json.dumps(failing),
    )
    done = subprocess.run([node, "-e", program], capture_output=True, check=True, encoding="utf-8")
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
    calls, released, error = replay(record())
    groups = [call for call in calls if call[0] == "setBindGroup"]
    assert (released, error) == (1, "")
    assert groups[0][1:3] == [0, "uniforms"]
    assert groups[0][3][groups[0][4] : groups[0][4] + groups[0][5]] == [256, 4294967040]
    assert [call for call in calls if call[0] != "setBindGroup"] == [
        ["beginRenderPass", "description"],
        ["setPipeline", "pipeline"],
        ["setViewport", -1.5, 2, 30, 40, 0.25, 1],
        ["setScissorRect", 1, 2, 3, 4],
        ["setBlendConstant", [0.5, 0.25, 0, 1]],
        ["setStencilReference", 7],
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
    assert groups[1] == ["setBindGroup", 1, "storage"]


def test_a_pass_without_commands_begins_and_ends() -> None:
    calls, released, error = replay(begin_pass())
    assert (calls, released, error) == ([["beginRenderPass", "description"], ["end"]], 1, "")


def test_a_pass_ends_although_a_call_is_refused() -> None:
    calls, released, error = replay(record(), failing="setScissorRect")
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
    render = begin_pass()
    table = render.table
    assert [render.number(each) for each in (first, second, first)] == [1, 2, 1]
    table.forget(first)
    assert table.objects == {1: first, 2: second}  # type: ignore[attr-defined]  # commands of the pass may use it
    assert PassCommands(table, "encoder", "description").number(third) == 3
    assert table.objects == {2: second, 3: third}  # type: ignore[attr-defined]


# -- bundles -----------------------------------------------------------------------------------------------


def test_a_bundle_has_the_draws_and_the_pass_sets_its_viewport() -> None:
    render = begin_pass()
    pass_commands.set_pipeline(render, "pipeline")
    pass_commands.set_viewport(render, 0.0, 0.0, 8.0, 8.0, 0.0, 1.0)
    pass_commands.set_vertex_buffer(render, 0, "vertices", 0, 64)
    pass_commands.draw(render, 3, 2, 1, 9)
    calls, released, error = replay(render, bundles=True)
    assert (released, error) == (2, "")
    assert calls == [
        ["createRenderBundleEncoder", "the formats"],
        ["setPipeline", "pipeline"],
        ["setVertexBuffer", 0, "vertices", 0, 64],
        ["draw", 3, 2, 1, 9],
        ["finish"],
        ["beginRenderPass", "description"],
        ["setViewport", 0, 0, 8, 8, 0, 1],
        ["executeBundles", ["the bundle"]],
        ["end"],
    ]


@pytest.mark.parametrize("has_query", [False, True])
def test_a_pass_that_a_bundle_cannot_have_makes_its_calls(has_query: bool) -> None:
    """A query counts draws, and a stencil reference between draws is that of the later ones."""
    render = begin_pass()
    pass_commands.set_bind_group(render, 0, "group", 3, (12, 13, 14))  # offsets that look like commands
    if has_query:
        pass_commands.begin_occlusion_query(render, 0)
    pass_commands.draw(render, 3, 1, 0, 0)
    if not has_query:
        pass_commands.set_stencil_reference(render, 1)
    calls, _, error = replay(render, bundles=True)
    assert error == ""
    assert [call[0] for call in calls] == [
        "beginRenderPass",
        "setBindGroup",
        *["beginOcclusionQuery"] * has_query,
        "draw",
        *["setStencilReference"] * (not has_query),
        "end",
    ]


def record_draws(count: int, first: int = 0) -> PassCommands:
    render = begin_pass()
    for _ in range(count):
        pass_commands.draw(render, 3, 1, first, 0)
    return render


def test_a_pass_becomes_a_bundle_when_it_is_drawn_again() -> None:
    numbers = itertools.count(1)
    cache = BundleCache(lambda render: f"bundle {next(numbers)}")
    draws = LEAST_BUNDLED // 20 + 1
    assert cache.get(record_draws(draws)) is None
    assert [cache.get(record_draws(draws)) for _ in range(3)] == ["bundle 1"] * 3
    assert [cache.get(record_draws(draws, first)) for first in (1, 1, 0)] == [None, "bundle 2", "bundle 1"]


def test_short_passes_and_passes_that_differ_each_time_make_no_bundle() -> None:
    bundled: list[PassCommands] = []
    cache = BundleCache(bundled.append)
    for first in range(MAX_BUNDLES + 1):
        assert cache.get(record_draws(2)) is None
        assert cache.get(record_draws(LEAST_BUNDLED // 20 + 1, first)) is None
    assert cache.get(record_draws(LEAST_BUNDLED // 20 + 1, 0)) is None  # the oldest was forgotten
    assert bundled == []
    cache.get(record_draws(LEAST_BUNDLED // 20 + 1, MAX_BUNDLES))
    assert len(bundled) == 1


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
