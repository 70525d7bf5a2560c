"""Render passes as one array of numbers, which one call into the page encodes.

A call from Python into the page costs 2 to 3 µs, as much as WebGPU's own work for a draw. So the commands of a
pass are packed into the heap that Python and JavaScript share, 32-bit words each, and `REPLAY` makes the calls
of WebGPU from them when the pass ends. Nothing is copied: JavaScript reads the words where Python wrote them.

- A record is the number of its command, then its arguments. Objects of WebGPU have numbers in an `ObjectTable`,
  none of which is used twice. So equal words are the same commands, in whichever pass.
- Runs of draws that come a second time become bundles (`GPURenderBundle`): one call of WebGPU in place of two or three
  for each draw. The words of a draw say whether a run ends after it. So where a draw more or less moves the others,
  later runs are those of earlier frames again.
- Offsets and sizes of buffers are in words of 4 bytes, so that 4 GiB fit.
- The page's pass begins with the replay too, so that an interrupt never leaves the page's encoder locked.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from struct import Struct
from typing import Final

from rhi.backends.webgpu.implementation import Handle

REPLAY: Final = """(() => {
const FIRST_STATE = 8;  // commands from here on aren't in bundles: viewports, other states of a pass, queries
const LEAST = 16, MOST = 256, MAX_RUNS = 1024;  // draws of a run that becomes a bundle; runs that are remembered
const formats = ["uint16", "uint32"];
const lengths = [1, 0, 4, 5, 4, 4, 3, 3, 6, 4, 1, 4, 1, 0];  // of the arguments; bind groups say their own
const runs = new Map();  // by a hash of their words: the words, and the bundle if they came a second time

const encode = (pass, objects, words, integers, floats, i, end) => {
  const color = [0, 0, 0, 0];
  while (i < end) {
    switch (words[i++]) {
      case 0: pass.setPipeline(objects.get(words[i++])); break;
      case 1: {
        const count = words[i + 2], next = i + 3 + count;
        if (count) pass.setBindGroup(words[i], objects.get(words[i + 1]), words, i + 3, count);
        else pass.setBindGroup(words[i], objects.get(words[i + 1]));
        i = next;
        break;
      }
      case 2: pass.draw(words[i], words[i + 1], words[i + 2], words[i + 3]); i += 4; break;
      case 3:
        pass.drawIndexed(words[i], words[i + 1], words[i + 2], integers[i + 3], words[i + 4]);
        i += 5;
        break;
      case 4:
        pass.setVertexBuffer(words[i], objects.get(words[i + 1]), 4 * words[i + 2], 4 * words[i + 3]);
        i += 4;
        break;
      case 5:
        pass.setIndexBuffer(objects.get(words[i]), formats[words[i + 1]], 4 * words[i + 2], 4 * words[i + 3]);
        i += 4;
        break;
      case 6:
        for (let draw = 0; draw < words[i + 2]; draw++)
          pass.drawIndirect(objects.get(words[i]), 4 * words[i + 1] + 16 * draw);
        i += 3;
        break;
      case 7:
        for (let draw = 0; draw < words[i + 2]; draw++)
          pass.drawIndexedIndirect(objects.get(words[i]), 4 * words[i + 1] + 20 * draw);
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

const measure = (words, i) => words[i] === 1 ? 4 + words[i + 3] : 1 + lengths[words[i]];
const isDraw = (command) => command === 2 || command === 3 || command === 6 || command === 7;
const mix = (hash, words, i, end) => {
  for (; i < end; i++) hash = Math.imul(hash ^ words[i], 0x01000193);
  return hash ^ hash >>> 15;
};
// Of bindings that a draw needs, by number: 0 the pipeline, 1 to 4 groups, 5 indices, then vertices.
const slot = (words, i) => [0, 1 + words[i + 1], , , 6 + words[i + 1], 5][words[i]];

// A run is draws that follow on each other, with their bindings. It ends where the hash of a draw says, so that a run
// comes again although others before it differ; `needs` are the bindings from before that it uses.
const findRun = (words, start, bound) => {
  const set = new Set();
  let i = start, draws = 0, hash = 0, needs = null, latest = 0x811c9dc5;
  while (i < words.length && words[i] < FIRST_STATE && draws < MOST) {
    const next = i + measure(words, i), command = words[i];
    latest = mix(latest, words, i, next);
    if (isDraw(command)) {
      needs ??= [...bound].filter(([number]) => !set.has(number)).map(([, position]) => position);
      draws += 1;
      hash = Math.imul(hash, 31) + latest | 0;
      if (draws >= LEAST && (latest & 63) === 0) { i = next; break; }
      latest = 0x811c9dc5;
    } else if (needs === null) set.add(slot(words, i));
    i = next;
  }
  for (const position of needs ?? []) hash = mix(hash, words, position, position + measure(words, position));
  return {end: i, draws, hash, needs: needs ?? []};
};
const collect = (words, start, {end, needs}) => {
  const parts = [...needs.map((i) => words.subarray(i, i + measure(words, i))), words.subarray(start, end)];
  const all = new Uint32Array(parts.reduce((size, part) => size + part.length, 0));
  let size = 0;
  for (const part of parts) { all.set(part, size); size += part.length; }
  return all;
};
const isSame = (stored, words, start, {end, needs}) => {
  let at = 0;
  for (const i of needs)
    for (let j = i, stop = i + measure(words, i); j < stop; j++) if (stored[at++] !== words[j]) return false;
  if (stored.length !== at + end - start) return false;
  for (let i = start; i < end; i++) if (stored[at++] !== words[i]) return false;
  return true;
};
const getBundle = (device, description, objects, words, start, run) => {
  const known = runs.get(run.hash);
  const entry = known && isSame(known.words, words, start, run) ? known : null;
  runs.delete(run.hash);
  if (!entry) {
    if (runs.size >= MAX_RUNS) runs.delete(runs.keys().next().value);
    runs.set(run.hash, {words: collect(words, start, run), bundle: null});
    return null;
  }
  runs.set(run.hash, entry);  // the latest is the last
  if (!entry.bundle) {
    const encoder = device.createRenderBundleEncoder(description.formats), {buffer, length} = entry.words;
    encode(encoder, objects, entry.words, new Int32Array(buffer), null, 0, length);
    entry.bundle = encoder.finish();
  }
  return entry.bundle;
};
const encodeRuns = (device, description, pass, objects, words, integers, floats) => {
  const bound = new Map();  // where the words bind what is bound now, by its slot
  let bundles = [], isLost = false;
  for (let start = 0; start < words.length;) {
    const isRun = words[start] < FIRST_STATE;
    const run = isRun ? findRun(words, start, bound) : {end: start + measure(words, start), draws: 0};
    const bundle = run.draws >= LEAST ? getBundle(device, description, objects, words, start, run) : null;
    if (bundle) bundles.push(bundle);
    else {
      if (bundles.length) { pass.executeBundles(bundles); bundles = []; isLost = true; }
      if (isLost && run.draws) {  // a bundle leaves nothing bound
        for (const i of bound.values()) encode(pass, objects, words, integers, floats, i, i + measure(words, i));
        isLost = false;
      }
      encode(pass, objects, words, integers, floats, start, run.end);
    }
    for (let i = start; i < run.end; i += measure(words, i))
      if (words[i] < FIRST_STATE && !isDraw(words[i])) bound.set(slot(words, i), i);
    start = run.end;
  }
  if (bundles.length) pass.executeBundles(bundles);
};
return (device, encoder, description, data, objects) => {
  const pass = encoder.beginRenderPass(description);
  try {
    const bytes = data.getBuffer("u8"), {buffer, byteOffset, byteLength} = bytes.data;
    const views = [Uint32Array, Int32Array, Float32Array].map((type) => new type(buffer, byteOffset, byteLength / 4));
    try { encodeRuns(device, description, pass, objects, ...views); } finally { bytes.release(); }
  } finally { pass.end(); }
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

    def __init__(self, table: ObjectTable, encoder: Handle = None, description: Handle = None) -> None:
        """Without an encoder, they are a part of a pass to come."""
        if encoder is not None:
            table.begin_pass()
        self.table = table
        self.encoder = encoder
        self.description = description
        self.numbers = table.numbers

    @property
    def _internal(self) -> PassCommands:
        return self

    def number(self, handle: Handle) -> int:
        """Return the number of an object."""
        number = self.numbers.get(id(handle))
        return self.table.number(handle) if number is None else number


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
