"""The packed commands of a render pass, and the calls that JavaScript makes of them."""

from __future__ import annotations

import json
import subprocess
from typing import Any

import numpy as np
import pytest
from web_kit import run_in_node

from rhi.backends.web import pass_commands
from rhi.backends.web.pass_commands import REPLAY, PassCommands

_PROGRAM = """
const replay = {replay};
const calls = [];
const listen = (name) => new Proxy({{}}, {{get: (_, method) => (...values) => {{
  calls.push([method, ...values.map((value) => value?.BYTES_PER_ELEMENT ? [...value] : value)]);
  if (method === {failing}) throw new Error("refused");
  return method === "beginRenderPass" ? listen("pass") : undefined;
}}}});
const bytes = Uint8Array.from({data});
let released = 0, error = "";
const data = {{getBuffer: () => ({{data: bytes, release() {{ released += 1; }}}})}};
try {{ replay(listen("encoder"), "description", data, ...{objects}); }} catch (each) {{ error = each.message; }}
console.log(JSON.stringify([calls, released, error]));
"""


def replay(commands: PassCommands, failing: str = "") -> tuple[list[Any], int, str]:
    """The calls that JavaScript makes, how often it releases the array, and its error."""
    node = run_in_node.find_node()
    if node is None:
        pytest.skip('no node: pip install "rhi[test]"')
    program = _PROGRAM.format(
        replay=REPLAY,
        data=list(commands),
        objects=json.dumps(commands.objects),
        failing=json.dumps(failing),
    )
    done = subprocess.run([node, "-e", program], capture_output=True, check=True, encoding="utf-8")
    calls, released, error = json.loads(done.stdout)
    return calls, released, error


def record() -> PassCommands:
    """A pass with one command of each kind."""
    render = PassCommands("encoder", "description")
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
    calls, released, error = replay(PassCommands("encoder", "description"))
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


def test_an_object_has_one_number_in_a_pass() -> None:
    render = PassCommands("encoder", "description")
    first, second = ["buffer"], ["buffer"]  # equal, and not the same
    assert [render.number(each) for each in (first, second, first)] == [0, 1, 0]
    assert render.objects == [first, second]


@pytest.mark.parametrize("indexed", [False, True])
def test_a_draw_that_is_packed_in_advance_has_the_bytes_of_its_call(indexed: bool) -> None:
    render = PassCommands("encoder", "description")
    if indexed:
        pass_commands.draw_indexed(render, 6, 1, 2, -4, 8)
    else:
        pass_commands.draw(render, 6, 1, 2, 8)
    assert pass_commands.pack_draw(indexed, 6, 2, -4, 8) == bytes(render)


def test_a_record_is_whole_words() -> None:
    assert np.frombuffer(record(), np.uint32).size * 4 == len(record())
