// Compiles WGSL with Tint, the compiler of Dawn: `node tint.mjs FOLDER`, where FOLDER has the package `webgpu`.
// It reads an object of texts by name as JSON from standard input, and writes an object of the messages about the
// texts that are refused. Dawn's null backend needs no GPU.
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

const { create, globals } = await import(pathToFileURL(join(process.argv[2], "webgpu", "index.js")));
Object.assign(globalThis, globals);
const gpu = create(["backend=null"]);
const adapter = await gpu.requestAdapter();
const features = [...adapter.features].filter((name) => !name.startsWith("chromium"));
const device = await adapter.requestDevice({ requiredFeatures: features });
device.addEventListener("uncapturederror", () => {});
const refusals = {};
for (const [name, code] of Object.entries(JSON.parse(readFileSync(0, "utf8")))) {
  device.pushErrorScope("validation");
  const module = device.createShaderModule({ code });
  const { messages } = await module.getCompilationInfo();
  const error = await device.popErrorScope();
  const lines = code.split("\n");
  const errors = messages.filter((each) => each.type === "error");
  if (errors.length || error) {
    const texts = errors.map((each) => `${each.message.trim()}\n  ${lines[each.lineNum - 1]?.trim()}`);
    refusals[name] = texts.join("\n") || error.message;
  }
}
process.stdout.write(JSON.stringify(refusals), () => process.exit(0));
