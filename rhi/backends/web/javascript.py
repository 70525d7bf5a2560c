"""The backend's JavaScript: functions that take plain arguments, so that a call is one step into the page.

`FUNCTIONS` is an object of functions. Those of passes take the pass first. `watch` begins to note a device's
errors and its loss, since a page reports them to nobody who isn't listening.
"""

from __future__ import annotations

from typing import Final

FUNCTIONS: Final = """({
set_compute_pipeline: (pass, pipeline) => pass.setPipeline(pipeline),
set_compute_bind_group: (pass, index, group, ...offsets) => pass.setBindGroup(index, group, offsets),
dispatch_workgroups: (pass, x, y, z) => pass.dispatchWorkgroups(x, y, z),
dispatch_workgroups_indirect: (pass, buffer, offset) => pass.dispatchWorkgroupsIndirect(buffer, offset),
write_timestamp: (encoder, querySet, beginningOfPassWriteIndex) =>
  encoder.beginComputePass({timestampWrites: {querySet, beginningOfPassWriteIndex}}).end(),
describe_render_pass: (colors, depth, occlusionQuerySet, formats, depthStencilFormat, sampleCount) => {
  const colorFormats = formats.split(",").filter(Boolean);
  const description = {colorAttachments: [], occlusionQuerySet, formats: {colorFormats, sampleCount}};  // of a bundle
  if (depthStencilFormat) description.formats.depthStencilFormat = depthStencilFormat;
  for (let i = 0; i < colors.length; i += 8) {
    const [view, resolveTarget, clears, stores, r, g, b, a] = colors.slice(i, i + 8);
    const color = {view, loadOp: clears ? "clear" : "load", storeOp: stores ? "store" : "discard"};
    if (clears) color.clearValue = [r, g, b, a];
    if (resolveTarget) color.resolveTarget = resolveTarget;
    description.colorAttachments.push(color);
  }
  if (depth) {
    const [view, clears, value, hasStencil, clearsStencil, stencil] = depth;
    const target = {view, depthLoadOp: clears ? "clear" : "load", depthStoreOp: "store", depthClearValue: value};
    if (hasStencil) {
      target.stencilLoadOp = clearsStencil ? "clear" : "load";
      target.stencilStoreOp = "store";
      target.stencilClearValue = stencil;
    }
    description.depthStencilAttachment = target;
  }
  return description;
},
array: (...values) => values,
bytes_of: (data) => {
  const view = data.getBuffer("u8");
  try { return view.data.slice(); } finally { view.release(); }
},
write_buffer: (queue, buffer, offset, data, start, size) => {
  const view = data.getBuffer("u8");
  try { queue.writeBuffer(buffer, offset, view.data, start, size); } finally { view.release(); }
},
write_mapped: (buffer, data) => {
  const view = data.getBuffer("u8");
  try { new Uint8Array(buffer.getMappedRange()).set(view.data); } finally { view.release(); }
},
watch: (device) => {
  const state = {errors: [], lost: "", reached: 0, mappings: []};
  device.addEventListener("uncapturederror", (event) => {
    event.preventDefault();
    const memory = event.error.constructor.name === "GPUOutOfMemoryError";
    state.errors.push((memory ? "out of memory: " : "") + event.error.message);
  });
  device.lost.then((info) => { state.lost = `device is lost (${info.reason}): ${info.message}`; });
  return state;
},
take_error: (state) => state.lost || (state.errors.length ? state.errors.splice(0).join("\\n") : ""),
submit: (queue, commands) => queue.submit([commands]),
signal: (queue, state, value) => {
  const reach = () => { state.reached = Math.max(state.reached, value); };
  Promise.allSettled([queue.onSubmittedWorkDone(), ...state.mappings.splice(0)]).then(reach);
},
work_done: (queue) => queue.onSubmittedWorkDone().catch(() => undefined),
sleep: (seconds) => new Promise((resolve) => setTimeout(resolve, 1000 * seconds)),
turn: () => new Promise((resolve) => {
  if (typeof setImmediate === "function") { setImmediate(resolve); return; }
  const channel = new MessageChannel();
  channel.port1.onmessage = () => { channel.port1.close(); resolve(); };
  channel.port2.postMessage(0);
}),
wait_for: (queue, seconds) => Promise.race([
  queue.onSubmittedWorkDone().catch(() => undefined),
  new Promise((resolve) => setTimeout(resolve, 1000 * seconds)),
]),
map: (state, buffer, size) => {
  const mapping = {done: false, error: ""};
  const mapped = buffer.mapAsync(1, 0, size).then(
    () => { mapping.done = true; },
    (error) => { mapping.done = true; mapping.error = String(error.message || error) || "refused"; },
  );
  state.mappings.push(mapped);
  return mapping;
},
read_mapped: (buffer, offset, size) => {
  const copy = new Uint8Array(buffer.getMappedRange(offset, size)).slice();
  buffer.unmap();
  return copy;
},
compile: (device, label, code) => device.createShaderModule({label, code}),
compile_checked: async (device, label, code) => {
  device.pushErrorScope("validation");
  const module = device.createShaderModule({label, code});
  const scope = device.popErrorScope();
  const info = await module.getCompilationInfo();
  const error = await scope;
  const rows = info.messages.filter((message) => message.type === "error");
  return {module, refused: error !== null || rows.length > 0, text: error ? error.message : "",
          messages: rows.map((message) => [message.message, message.lineNum])};
},
request_adapter: (gpu) => gpu.requestAdapter({powerPreference: "high-performance"}),
request_device: (adapter, features) => adapter.requestDevice({requiredFeatures: features}),
has: (set, name) => set.has(name),
})"""
