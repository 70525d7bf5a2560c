// Runs Python in Pyodide, without a browser: `node pyodide.mjs FOLDER WHEELS MOUNT=PATH…`, where FOLDER has the
// package `pyodide` and WHEELS those of Pyodide's own distribution. The program is read from standard input; its exit
// status is this one's. Each PATH of this machine is the folder MOUNT to Python.
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

const [folder, wheels, ...mounts] = process.argv.slice(2);
const { loadPyodide } = await import(pathToFileURL(join(folder, "pyodide", "pyodide.mjs")));
const pyodide = await loadPyodide({ packageCacheDir: wheels });
await pyodide.loadPackage(["numpy"], { messageCallback: () => {} });
for (const mount of mounts) {
  const [target, root] = mount.split("=");
  pyodide.FS.mkdirTree(target);
  pyodide.FS.mount(pyodide.FS.filesystems.NODEFS, { root }, target);
}
try {
  pyodide.runPython(readFileSync(0, "utf8"), { filename: "/program.py" });
} catch (error) {
  const exit = /SystemExit: (\d+)/.exec(error.message);
  if (!exit) console.error(error.message);
  process.exitCode = exit ? Number(exit[1]) : 1;
}
