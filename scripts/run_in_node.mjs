// The part of run_in_node.py in JavaScript: Pyodide, with WebGPU of Dawn as the page's `navigator.gpu`.
//
//   node --experimental-wasm-jspi run_in_node.mjs PYODIDE DAWN PROGRAM [ARGUMENT…]
//
// PYODIDE: a folder with Pyodide and NumPy's wheel. DAWN: the folder of npm's `webgpu`, or `none`.
// Environment: RHI_WEB_MOUNTS: folders that Python imports from, separated by colons; RHI_WEB_DAWN_OPTIONS:
// options of Dawn, separated by commas; RHI_WEB_PACKAGES: packages of Pyodide's distribution (numpy). The file system of this machine is visible below /host.
import { pathToFileURL } from "node:url";
import { readFileSync } from "node:fs";
import { resolve } from "node:path";

const [pyodide, dawn, program, ...programArguments] = process.argv.slice(2);
const { loadPyodide } = await import(pathToFileURL(resolve(pyodide, "pyodide.mjs")));
const python = await loadPyodide({ indexURL: resolve(pyodide) + "/" });
await python.loadPackage((process.env.RHI_WEB_PACKAGES ?? "numpy").split(","), { messageCallback: () => {} });
if (dawn !== "none") {
  const { create, globals } = await import(pathToFileURL(resolve(dawn, "index.js")));
  Object.assign(globalThis, globals);
  const options = (process.env.RHI_WEB_DAWN_OPTIONS ?? "").split(",").filter(Boolean);
  Object.defineProperty(globalThis.navigator, "gpu", { value: create(options), configurable: true });
}
python.FS.mkdirTree("/host");
python.FS.mount(python.FS.filesystems.NODEFS, { root: "/" }, "/host");
const mounts = (process.env.RHI_WEB_MOUNTS ?? "").split(":").filter(Boolean).map((path) => "/host" + resolve(path));
python.globals.set("_arguments", python.toPy([program, ...programArguments]));
python.globals.set("_mounts", python.toPy(mounts));
python.runPython(`
import sys
sys.dont_write_bytecode = True
sys.path[:0] = list(_mounts[:1])
sys.path += list(_mounts[1:])  # Pyodide's own NumPy comes first
sys.argv = list(_arguments)
del _arguments, _mounts
`);
python.globals.set("_source", readFileSync(program, "utf8"));
python.globals.set("_filename", "/host" + resolve(program));
const code = await python.runPythonAsync(`
import traceback, types
from pyodide.code import eval_code_async

async def _run():
    module = sys.modules["__main__"] = types.ModuleType("__main__")  # in which annotations are looked up
    module.__file__ = _filename
    try:
        await eval_code_async(_source, module.__dict__, filename=_filename)
    except SystemExit as error:
        return error.code if isinstance(error.code, int) else int(error.code is not None)
    except BaseException:
        traceback.print_exc()
        return 1
    return 0

await _run()
`);
process.exit(code);
