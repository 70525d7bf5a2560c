// Live programs in the pages of the documentation: an editor, a canvas, and Python of Pyodide.
//
//   <div class="rhi-live" data-program="triangle.py"></div>
//
// Nothing is loaded before the reader presses Run, and nothing runs but the text in the editor, which comes from the
// site's own files: no address of a page is read. Each file that is loaded has the SHA-256 of manifest.json.
const HOME = new URL("./", import.meta.url);
const manifest = await (await fetch(new URL("manifest.json", HOME))).json();
const INDEX = new URL("pyodide/", HOME).href;  // where Pyodide asks for its files
const loaded = new Map();  // the names of files, and their bytes

const create = (tag, className, text = "") => {
  const element = document.createElement(tag);
  element.className = className;
  element.textContent = text;
  return element;
};

// -- loading --------------------------------------------------------------------------------------------------

const describeSize = (bytes) => (bytes / 1e6).toFixed(1);
const listFiles = (program) => [...manifest.core, ...(manifest.further[program]?.files ?? [])].filter((name) => !loaded.has(name));
const sumSizes = (names) => names.reduce((sum, name) => sum + manifest.files[name].bytes, 0);

async function loadFile(name, report) {
  const file = manifest.files[name];
  const response = await fetch(new URL(file.url, HOME));
  if (!response.ok) throw new Error(`${file.url}: ${response.status} ${response.statusText}`);
  const parts = [];
  const reader = response.body.getReader();
  for (;;) {
    const { done, value } = await reader.read();
    if (done) break;
    parts.push(value);
    report(value.length);
  }
  const data = new Uint8Array(await new Blob(parts).arrayBuffer());
  const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", data));
  const hex = [...digest].map((byte) => byte.toString(16).padStart(2, "0")).join("");
  if (hex !== file.sha256) throw new Error(`${file.url} has another SHA-256 than the one that this site pins`);
  loaded.set(name, data);
}

async function loadFiles(names, report) {
  if (!globalThis.crypto?.subtle) throw new Error("a page from https or localhost is needed");
  const total = sumSizes(names);
  let sum = 0;
  const note = (bytes) => { sum += bytes; report(sum / total, `${describeSize(sum)} of ${describeSize(total)} MB`); };
  await Promise.all(names.map((name) => loadFile(name, note)));
}

const TYPES = { js: "text/javascript", mjs: "text/javascript", wasm: "application/wasm", json: "application/json" };
const makeBlob = (name) => new Blob([loaded.get(name)], { type: TYPES[name.split(".").pop()] ?? "application/octet-stream" });
const importFile = (name) => import(URL.createObjectURL(makeBlob(name)));

// Pyodide asks for its files again: it gets those that were checked.
async function withLoadedFiles(task) {
  const pageFetch = globalThis.fetch;
  globalThis.fetch = (resource, options) => {
    const name = String(resource?.url ?? resource).replace(INDEX, "");
    return loaded.has(name) ? Promise.resolve(new Response(makeBlob(name))) : pageFetch(resource, options);
  };
  try {
    return await task();
  } finally {
    globalThis.fetch = pageFetch;
  }
}

const loadPackages = (python, names) => python.loadPackage(names, { messageCallback() {}, checkIntegrity: false });

async function startPython() {
  await importFile("pyodide.asm.js");
  const { loadPyodide } = await importFile("pyodide.mjs");
  const python = await loadPyodide({ indexURL: INDEX, lockFileURL: `${INDEX}lock.json` });
  await loadPackages(python, manifest.packages);
  for (const name of manifest.archives) python.unpackArchive(loaded.get(name), "zip", { extractDir: "/home/pyodide/site" });
  python.FS.writeFile("/home/pyodide/site/live_runner.py", loaded.get("runner.py"));
  python.runPython("import sys; sys.path.insert(0, '/home/pyodide/site')");
  return { python, runner: python.pyimport("live_runner") };
}

async function loadPython(report) {
  await loadFiles(listFiles(), report);
  report(1, "Python starts…");
  return withLoadedFiles(startPython);
}

// The packages that only this program imports.
async function loadFurther(program, python, report) {
  const names = listFiles(program);
  if (names.length === 0) return;
  await loadFiles(names, report);
  await withLoadedFiles(() => loadPackages(python, manifest.further[program].packages));
}

let engine = null;  // a promise of Python, once it is loaded for this page
let running = null;  // the program that runs, with its end

// -- the editor ------------------------------------------------------------------------------------------------

const TOKEN = /("""[^]*?(?:"""|$)|'''[^]*?(?:'''|$)|"(?:\\.|[^"\\\n])*"?|'(?:\\.|[^'\\\n])*'?)|(#[^\n]*)|(@[\w.]+)|\b(and|as|assert|async|await|break|class|continue|def|del|elif|else|except|False|finally|for|from|global|if|import|in|is|lambda|None|not|or|pass|raise|return|True|try|while|with|yield)\b|\b(\d[\w.]*)/g;
const escapeText = (text) => text.replace(/[&<>]/g, (sign) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;" })[sign]);

function colour(text) {
  let html = "", end = 0;
  for (const token of text.matchAll(TOKEN)) {
    const kind = ["s", "c", "d", "k", "n"][token.slice(1).findIndex((part) => part !== undefined)];
    html += `${escapeText(text.slice(end, token.index))}<span class="${kind}">${escapeText(token[0])}</span>`;
    end = token.index + token[0].length;
  }
  return html + escapeText(text.slice(end)) + "\n";
}

class Editor {
  constructor(text) {
    this.element = create("div", "rhi-live-editor");
    this.gutter = create("pre", "rhi-live-gutter");
    this.coloured = create("pre", "");
    this.area = create("textarea", "");
    Object.assign(this.area, { value: text, spellcheck: false, autocapitalize: "off", wrap: "off" });
    this.area.setAttribute("aria-label", "source of the program");
    const body = create("div", "rhi-live-text");
    body.append(this.coloured, this.area);
    this.element.append(this.gutter, body);
    this.area.addEventListener("input", () => this.update());
    this.area.addEventListener("keydown", (event) => this.indent(event));
    this.update();
  }

  get text() { return this.area.value; }

  set text(text) { this.area.value = text; this.update(); }

  update(wrong = 0) {
    const count = this.text.split("\n").length;
    this.gutter.replaceChildren();
    for (let line = 1; line <= count; line++) this.gutter.append(create("span", line === wrong ? "rhi-live-wrong" : "", `${line}`), "\n");
    this.coloured.innerHTML = colour(this.text);
  }

  mark(line) {
    this.update(line);
    if (!line) return;
    const height = this.gutter.scrollHeight / this.text.split("\n").length;
    this.element.scrollTop = Math.max(0, (line - 6) * height);
  }

  indent(event) {
    if (event.key !== "Tab" || event.shiftKey || event.ctrlKey) return;
    event.preventDefault();
    this.area.setRangeText("    ", this.area.selectionStart, this.area.selectionEnd, "end");
    this.update();
  }
}

// -- a live program --------------------------------------------------------------------------------------------

async function findObstacle() {
  if (!navigator.gpu) return "This browser has no WebGPU, or not on this page (it needs https or localhost).";
  try {
    return (await navigator.gpu.requestAdapter()) ? "" : "This browser has WebGPU, but no adapter for it: chrome://gpu or about:support says why.";
  } catch (error) {
    return `This browser refuses WebGPU: ${error.message}`;
  }
}

class LiveProgram {
  constructor(element) {
    this.element = element;
    this.name = element.dataset.program;
    this.usesGpu = element.dataset.device !== "null";
    this.openButton = create("button", "", `Edit and run ${this.name} in this page`);
    this.openButton.addEventListener("click", () => this.open());
    element.replaceChildren(this.openButton);
  }

  async open() {
    this.openButton.disabled = true;
    const obstacle = this.usesGpu ? await findObstacle() : "";
    if (obstacle) {
      this.element.dataset.state = "refused";
      const image = this.element.previousElementSibling?.querySelector("img");
      this.element.replaceChildren(create("p", "", image ? `${obstacle} The image above is what the program draws.` : obstacle));
      return;
    }
    this.source = await (await fetch(new URL(`programs/${this.name}`, HOME))).text();
    this.editor = new Editor(this.source);
    this.status = create("span", "rhi-live-status", this.describeLoad());
    this.status.setAttribute("role", "status");
    this.progress = create("progress", "");
    this.progress.setAttribute("aria-label", "loaded");
    this.progress.hidden = true;
    this.buttons = ["Run", "Stop", "Reset"].map((name) => create("button", `rhi-live-${name.toLowerCase()}`, name));
    const [run, stop, reset] = this.buttons;
    run.addEventListener("click", () => this.run());
    stop.addEventListener("click", () => this.stop());
    reset.addEventListener("click", () => { this.editor.text = this.source; });
    this.editor.area.addEventListener("keydown", (event) => { if (event.key === "Enter" && event.ctrlKey) this.run(); });
    const bar = create("div", "rhi-live-bar");
    bar.append(...this.buttons, this.progress, this.status);
    this.shown = create("div", "rhi-live-shown");
    this.output = create("pre", "rhi-live-output");
    const right = create("div", "rhi-live-result");
    right.append(this.shown, this.output);
    const panes = create("div", "rhi-live-panes");
    panes.append(this.editor.element, right);
    this.element.replaceChildren(bar, panes);
    this.element.dataset.state = "open";
  }

  describeLoad() {
    const names = listFiles(this.name);
    if (names.length === 0) return "";
    const contents = [...(loaded.size ? [] : manifest.contents), ...(manifest.further[this.name]?.contents ?? [])].join(", ");
    return `Run first loads ${contents}: ${describeSize(sumSizes(names))} MB from ${manifest.origin}, once for this page.`;
  }

  say(text) { this.status.textContent = text; }

  print(line) { this.output.textContent += `${line}\n`; }

  async run() {
    const [run] = this.buttons;
    if (run.disabled) return;
    run.disabled = true;
    this.element.dataset.state = "loading";
    try {
      const report = (part, text) => {
        this.progress.hidden = false;
        this.progress.value = part;
        this.say(text);
      };
      if (engine && !loaded.size) this.say("Python is being loaded");
      engine ??= loadPython(report).catch((error) => { engine = null; throw error; });
      const { python, runner } = await engine;
      await loadFurther(this.name, python, report);
      this.progress.hidden = true;
      await this.stop();
      this.editor.mark(0);
      this.output.textContent = "";
      this.output.classList.remove("rhi-live-failed");
      this.showCanvas();
      python.setStdout({ batched: (line) => this.print(line) });
      python.setStderr({ batched: (line) => this.print(line) });
      this.element.dataset.state = "running";
      this.say("runs");
      const start = performance.now();
      const ended = runner.run(this.editor.text, this.name, this.usesGpu).then(
        (text) => this.end(JSON.parse(text), start),
        (error) => this.end({ error: "the program ended Python", text: String(error.message), line: 0, tables: [] }, start),
      );
      running = { program: this, ended };
    } catch (error) {
      this.progress.hidden = true;
      this.end({ error: String(error.message ?? error), text: String(error), line: 0, tables: [] }, performance.now());
    } finally {
      run.disabled = false;
    }
  }

  showCanvas() {
    this.shown.replaceChildren();
    if (!this.usesGpu) return;
    const canvas = create("canvas", "");
    canvas.id = "canvas";
    canvas.tabIndex = 0;
    this.shown.append(canvas);
  }

  async stop() {
    if (!running) return;
    const { runner } = await engine;
    const stopped = running;
    running = null;
    runner.stop();
    await stopped.ended;
  }

  end(result, start) {
    if (result.error) {
      this.output.textContent += result.text;
      this.output.classList.add("rhi-live-failed");
      this.editor.mark(result.line);
      this.say(result.line ? `line ${result.line}: ${result.error}` : result.error);
    } else {
      this.say(`ended after ${((performance.now() - start) / 1000).toFixed(1)} s`);
    }
    for (const table of result.tables) this.showTable(table);
    this.element.dataset.state = result.error ? "failed" : "ended";
  }

  showTable({ device, rows }) {
    const table = create("table", "");
    const head = table.insertRow();
    for (const name of ["", `command of ${device}`, "line"]) head.append(create("th", "", name));
    for (const row of rows) {
      const cells = table.insertRow();
      for (const value of row) cells.insertCell().textContent = value || value === 0 ? value : "";
    }
    const box = create("div", "rhi-live-table");
    box.append(table);
    this.shown.append(box);
  }
}

for (const element of document.querySelectorAll(".rhi-live")) new LiveProgram(element);
