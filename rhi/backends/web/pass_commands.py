"""Render passes as one array of numbers, which one call into the page encodes.

A call from Python into the page costs 2 to 3 µs, as much as WebGPU's own work for a draw. So the commands of a
pass are packed into the heap that Python and JavaScript share, 32-bit words each, and `REPLAY` makes the calls
of WebGPU from them when the pass ends. Nothing is copied: JavaScript reads the words where Python wrote them.

- A record is the number of its command, then its arguments. Objects of WebGPU are numbers in a table of the
  pass, which also keeps them alive until they are used.
- Offsets and sizes of buffers are in words of 4 bytes, so that 4 GiB fit.
- The page's pass begins with the replay too, so that an interrupt never leaves the page's encoder locked.
"""

from __future__ import annotations

from collections.abc import Sequence
from struct import Struct
from typing import Final

from rhi.backends.webgpu.implementation import Handle

REPLAY: Final = """(encoder, description, data, ...objects) => {
  const pass = encoder.beginRenderPass(description), bytes = data.getBuffer("u8");
  try {
    const {buffer, byteOffset, byteLength} = bytes.data;
    const words = new Uint32Array(buffer, byteOffset, byteLength / 4);
    const integers = new Int32Array(buffer, byteOffset, byteLength / 4);
    const floats = new Float32Array(buffer, byteOffset, byteLength / 4);
    const formats = ["uint16", "uint32"], color = [0, 0, 0, 0];
    for (let i = 0; i < words.length;) {
      switch (words[i++]) {
        case 0: pass.setPipeline(objects[words[i++]]); break;
        case 1: {
          const count = words[i + 2], end = i + 3 + count;
          if (count) pass.setBindGroup(words[i], objects[words[i + 1]], words, i + 3, count);
          else pass.setBindGroup(words[i], objects[words[i + 1]]);
          i = end;
          break;
        }
        case 2: pass.draw(words[i], words[i + 1], words[i + 2], words[i + 3]); i += 4; break;
        case 3:
          pass.drawIndexed(words[i], words[i + 1], words[i + 2], integers[i + 3], words[i + 4]);
          i += 5;
          break;
        case 4:
          pass.setVertexBuffer(words[i], objects[words[i + 1]], 4 * words[i + 2], 4 * words[i + 3]);
          i += 4;
          break;
        case 5:
          pass.setIndexBuffer(objects[words[i]], formats[words[i + 1]], 4 * words[i + 2], 4 * words[i + 3]);
          i += 4;
          break;
        case 6:
          for (let draw = 0; draw < words[i + 2]; draw++)
            pass.drawIndirect(objects[words[i]], 4 * words[i + 1] + 16 * draw);
          i += 3;
          break;
        case 7:
          for (let draw = 0; draw < words[i + 2]; draw++)
            pass.drawIndexedIndirect(objects[words[i]], 4 * words[i + 1] + 20 * draw);
          i += 3;
          break;
        case 8:
          pass.setViewport(floats[i], floats[i + 1], floats[i + 2], floats[i + 3], floats[i + 4], floats[i + 5]);
          i += 6;
          break;
        case 9: pass.setScissorRect(words[i], words[i + 1], words[i + 2], words[i + 3]); i += 4; break;
        case 10: pass.setStencilReference(words[i++]); break;
        case 11:
          for (let channel = 0; channel < 4; channel++) color[channel] = floats[i++];
          pass.setBlendConstant(color);
          break;
        case 12: pass.beginOcclusionQuery(words[i++]); break;
        case 13: pass.endOcclusionQuery(); break;
        default: throw new Error(`no command ${words[i - 1]}`);
      }
    }
  } finally {
    bytes.release();
    pass.end();
  }
}"""

_pipeline = Struct("=2I").pack
_draw = Struct("=5I").pack
_draw_indexed = Struct("=4IiI").pack
_four_arguments = Struct("=5I").pack
_three_arguments = Struct("=4I").pack
_viewport = Struct("=I6f").pack
_color = Struct("=I4f").pack
_argument = Struct("=2I").pack
_groups: Final = tuple(Struct(f"={4 + count}I").pack for count in range(34))
"""Packs of a bind group, by its number of dynamic offsets."""


class PassCommands(bytearray):
    """The commands of a render pass, packed.

    Attributes:
        encoder: the page's command encoder.
        description: the page's description of the pass.
        objects: the objects that the commands use.
        numbers: their numbers, by the id of an object.
    """

    __slots__ = ("description", "encoder", "numbers", "objects")

    def __init__(self, encoder: Handle, description: Handle) -> None:
        self.encoder = encoder
        self.description = description
        self.objects: list[Handle] = []
        self.numbers: dict[int, int] = {}

    def number(self, handle: Handle) -> int:
        """Return the number of an object in the pass's table."""
        numbers, objects = self.numbers, self.objects
        number = numbers.setdefault(id(handle), len(objects))
        if number == len(objects):
            objects.append(handle)
        return number


def set_pipeline(render: PassCommands, pipeline: Handle) -> None:
    render += _pipeline(0, render.number(pipeline))


def set_bind_group(
    render: PassCommands, index: int, group: Handle, count: int, offsets: Sequence[int]
) -> None:
    number = render.numbers.get(id(group))
    if number is None:
        number = render.number(group)
    render += _groups[count](1, index, number, count, *offsets)


def draw(render: PassCommands, count: int, instances: int, first: int, base_instance: int) -> None:
    render += _draw(2, count, instances, first, base_instance)


def draw_indexed(
    render: PassCommands, count: int, instances: int, first: int, base_vertex: int, base_instance: int
) -> None:
    render += _draw_indexed(3, count, instances, first, base_vertex, base_instance)


def pack_draw(indexed: bool, count: int, first: int, base_vertex: int, base_instance: int) -> bytes:
    """Return the record of a draw of one instance."""
    if indexed:
        return _draw_indexed(3, count, 1, first, base_vertex, base_instance)
    return _draw(2, count, 1, first, base_instance)


def set_vertex_buffer(render: PassCommands, slot: int, buffer: Handle, offset: int, size: int) -> None:
    number = render.numbers.get(id(buffer))
    if number is None:
        number = render.number(buffer)
    render += _four_arguments(4, slot, number, offset // 4, size // 4)


def set_index_buffer(render: PassCommands, buffer: Handle, format: int, offset: int, size: int) -> None:
    render += _four_arguments(5, render.number(buffer), format, offset // 4, size // 4)


def multi_draw_indirect(render: PassCommands, buffer: Handle, offset: int, draws: int) -> None:
    render += _three_arguments(6, render.number(buffer), offset // 4, draws)


def multi_draw_indexed_indirect(render: PassCommands, buffer: Handle, offset: int, draws: int) -> None:
    render += _three_arguments(7, render.number(buffer), offset // 4, draws)


def set_viewport(
    render: PassCommands, x: float, y: float, width: float, height: float, near: float, far: float
) -> None:
    render += _viewport(8, x, y, width, height, near, far)


def set_scissor_rect(render: PassCommands, x: int, y: int, width: int, height: int) -> None:
    render += _four_arguments(9, x, y, width, height)


def set_stencil_reference(render: PassCommands, reference: int) -> None:
    render += _argument(10, reference)


def set_blend_constant(render: PassCommands, color: tuple[float, float, float, float]) -> None:
    render += _color(11, *color)


def begin_occlusion_query(render: PassCommands, slot: int) -> None:
    render += _argument(12, slot)


def end_occlusion_query(render: PassCommands) -> None:
    render += b"\x0d\x00\x00\x00"
