"""Render passes as one array of numbers, which one call into the page encodes.

A call from Python into the page costs 2 to 3 µs, as much as WebGPU's own work for a draw. So the commands of a
pass are packed into the heap that Python and JavaScript share, 32-bit words each, and `REPLAY` makes the calls
of WebGPU from them when the pass ends. Nothing is copied: JavaScript reads the words where Python wrote them.

- A record is the number of its command, then its arguments. Objects of WebGPU have numbers in an `ObjectTable`,
  none of which is used twice. So equal words are the same commands, in whichever pass.
- A pass that is drawn a second time with the same words becomes a `GPURenderBundle` (`BundleCache`): one call of WebGPU
  in place of two or three for each draw. Viewports and the like come before its draws, else it has none.
- Offsets and sizes of buffers are in words of 4 bytes, so that 4 GiB fit.
- The page's pass begins with the replay too, so that an interrupt never leaves the page's encoder locked.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from struct import Struct
from typing import Any, Final

from rhi.backends.webgpu.implementation import Handle

REPLAY: Final = """(() => {
const formats = ["uint16", "uint32"];
const lengths = [1, 0, 4, 5, 4, 4, 3, 3, 6, 4, 1, 4, 1, 0];  // of the arguments; bind groups say their own
const nothing = Object.fromEntries(["setPipeline", "setBindGroup", "setVertexBuffer", "setIndexBuffer", "draw",
  "drawIndexed", "drawIndirect", "drawIndexedIndirect", "setViewport", "setScissorRect", "setStencilReference",
  "setBlendConstant", "beginOcclusionQuery", "endOcclusionQuery"].map((name) => [name, () => {}]));
const use = (data, call) => {
  const bytes = data.getBuffer("u8");
  try {
    const {buffer, byteOffset, byteLength} = bytes.data;
    return call(...[Uint32Array, Int32Array, Float32Array].map((type) => new type(buffer, byteOffset, byteLength / 4)));
  } finally { bytes.release(); }
};
const isBundled = (words) => {  // a bundle sets no viewport and the like, and counts no samples
  let drawn = false;
  for (let i = 0; i < words.length;) {
    const command = words[i];
    if (command >= 12 || (command >= 8 && drawn)) return false;
    drawn ||= command === 2 || command === 3 || command === 6 || command === 7;
    i += command === 1 ? 4 + words[i + 3] : 1 + lengths[command];
  }
  return true;
};
const encode = (draws, pass, objects, words, integers, floats) => {
  const color = [0, 0, 0, 0];
  for (let i = 0; i < words.length;) {
    switch (words[i++]) {
      case 0: draws.setPipeline(objects.get(words[i++])); break;
      case 1: {
        const count = words[i + 2], end = i + 3 + count;
        if (count) draws.setBindGroup(words[i], objects.get(words[i + 1]), words, i + 3, count);
        else draws.setBindGroup(words[i], objects.get(words[i + 1]));
        i = end;
        break;
      }
      case 2: draws.draw(words[i], words[i + 1], words[i + 2], words[i + 3]); i += 4; break;
      case 3:
        draws.drawIndexed(words[i], words[i + 1], words[i + 2], integers[i + 3], words[i + 4]);
        i += 5;
        break;
      case 4:
        draws.setVertexBuffer(words[i], objects.get(words[i + 1]), 4 * words[i + 2], 4 * words[i + 3]);
        i += 4;
        break;
      case 5:
        draws.setIndexBuffer(objects.get(words[i]), formats[words[i + 1]], 4 * words[i + 2], 4 * words[i + 3]);
        i += 4;
        break;
      case 6:
        for (let draw = 0; draw < words[i + 2]; draw++)
          draws.drawIndirect(objects.get(words[i]), 4 * words[i + 1] + 16 * draw);
        i += 3;
        break;
      case 7:
        for (let draw = 0; draw < words[i + 2]; draw++)
          draws.drawIndexedIndirect(objects.get(words[i]), 4 * words[i + 1] + 20 * draw);
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
};
return {
  replay: (encoder, description, data, objects, bundle) => {
    const pass = encoder.beginRenderPass(description);
    try {
      use(data, (...words) => encode(bundle ? nothing : pass, pass, objects, ...words));
      if (bundle) pass.executeBundles([bundle]);
    } finally { pass.end(); }
  },
  bundle: (device, description, data, objects) => use(data, (words, ...others) => {
    if (!isBundled(words)) return undefined;
    const bundle = device.createRenderBundleEncoder(description.formats);
    encode(bundle, nothing, objects, words, ...others);
    return bundle.finish();
  }),
};
})()"""

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


class ObjectTable:
    """The numbers of the page's objects, which JavaScript looks up in a map.

    Attributes:
        numbers: the numbers, by the `id` of a handle.
    """

    def __init__(self, store: Callable[[int, Handle], object], remove: Callable[[int], object]) -> None:
        """`store` and `remove` change the map of JavaScript."""
        self.numbers: dict[int, int] = {}
        self._store = store
        self._remove = remove
        self._latest = 0
        self._forgotten: list[int] = []

    def number(self, handle: Handle) -> int:
        """Return the number of an object, which gets one if it has none."""
        number = self.numbers.get(id(handle))
        if number is None:
            number = self._latest = self._latest + 1
            self._store(number, handle)
            self.numbers[id(handle)] = number
        return number

    def forget(self, handle: Handle) -> None:
        """Give up the number of an object that nobody uses any more, but for the commands of an open pass."""
        number = self.numbers.pop(id(handle), None)
        if number is not None:
            self._forgotten.append(number)

    def begin_pass(self) -> None:
        """Remove the objects that were forgotten, whose commands are done."""
        while self._forgotten:
            self._remove(self._forgotten.pop())


class PassCommands(bytearray):
    """The commands of a render pass, packed.

    Attributes:
        encoder: the page's command encoder.
        description: the page's description of the pass.
        table: the numbers of objects.
        numbers: those that objects have already, by the `id` of a handle.
    """

    __slots__ = ("description", "encoder", "numbers", "table")

    def __init__(self, table: ObjectTable, encoder: Handle, description: Handle) -> None:
        table.begin_pass()
        self.table = table
        self.encoder = encoder
        self.description = description
        self.numbers = table.numbers

    def number(self, handle: Handle) -> int:
        """Return the number of an object."""
        number = self.numbers.get(id(handle))
        return self.table.number(handle) if number is None else number


LEAST_BUNDLED: Final = 1 << 10
"""Bytes of a pass that may become a bundle: 20 draws or so, below which looking it up costs as much as its calls."""
MAX_BUNDLES: Final = 64
"""The number of passes whose words are kept."""


class BundleCache:
    """Bundles of the passes that were drawn last, by their words.

    A pass is seen once before it becomes a bundle, so what differs in each frame costs a look-up only.
    """

    def __init__(self, make: Callable[[PassCommands], Any]) -> None:
        """`make` returns a bundle of a pass, or None if WebGPU can't have it."""
        self._make = make
        self._bundles: dict[bytes, Any] = {}

    def get(self, render: PassCommands) -> Any:
        """Return the bundle of a pass, or None if its calls are to be made."""
        if len(render) < LEAST_BUNDLED:
            return None
        words = bytes(render)
        bundle = self._bundles.pop(words, _UNSEEN)
        if bundle is _SEEN:
            bundle = self._make(render)
        elif bundle is _UNSEEN:
            if len(self._bundles) == MAX_BUNDLES:
                del self._bundles[next(iter(self._bundles))]
            bundle = _SEEN
        self._bundles[words] = bundle  # the latest is the last
        return None if bundle is _SEEN else bundle


_UNSEEN: Final = object()
_SEEN: Final = object()


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


def pack_group(render: PassCommands, index: int, group: Handle, count: int) -> Callable[..., bytes]:
    """Return a function of the offsets that returns the record of a bind group."""
    return partial(_groups[count], 1, index, render.number(group), count)


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
