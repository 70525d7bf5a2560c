"""The web backend in node: Pyodide, with WebGPU of Dawn. `scripts/run_in_node.py` says what that needs."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from web_kit import (
    ENDLESS,
    EXPECTED_FAILURES,
    ROOT,
    check_kit,
    require_node,
    run_in_node,
    run_kit,
    run_program,
)

import rhi
from renderer.content import load_scene, save_scene
from rhi.errors.rules import DEVICE_DRIVER

pytestmark = pytest.mark.nightly
PROGRAMS = (
    "triangle",
    "textured_cube",
    "draw_lists",
    "shadow_map",
    "sprites",
    "terrain",
    "particles",
    "curves",
)
"""Programs of the gallery that the core profile allows, one of each kind."""
SIZE = (200, 150)


@pytest.fixture(autouse=True, scope="module")
def node() -> None:
    require_node()


def last_line(output: str) -> object:
    """The last line that a program printed, read as JSON."""
    return json.loads(output.strip().splitlines()[-1])


# -- pages without what a device needs ---------------------------------------------------------------------

_REFUSED = """
import json, sys
import js, rhi
from pyodide.code import run_js
run_js(sys.argv[1])
try:
    rhi.create_device()  # in a page "web" is the first that is tried
    refused = None
except rhi.DeviceError as error:
    refused = error.given
try:
    rhi.create_device("web")
    rule, tip = None, None
except rhi.DeviceError as error:
    rule, tip = error.rule.id, error.tip
print(json.dumps([refused, rule, tip]))
"""
_PAGE = "Object.defineProperty(globalThis.navigator, 'gpu', {{value: {}, configurable: true}})"


@pytest.mark.parametrize(
    ("page", "message", "tip"),
    [
        (_PAGE.format("undefined"), "the page has no WebGPU", "https"),
        (
            _PAGE.format("{requestAdapter: async () => null}"),
            "the page has WebGPU, but no adapter",
            "chrome://gpu",
        ),
        (
            _PAGE.format("{requestAdapter: async () => { throw new Error('blocked') }}"),
            "the adapter was refused: Error: blocked",
            "python -m rhi",
        ),
        (
            _PAGE.format(
                "{requestAdapter: async () => ({features: new Set(),"
                " requestDevice: async () => { throw new Error('too many') }})}"
            ),
            "the device was refused: Error: too many",
            "python -m rhi",
        ),
    ],
    ids=["no WebGPU", "no adapter", "adapter refused", "device refused"],
)
def test_a_page_that_has_no_device_is_refused_by_name(
    page: str, message: str, tip: str, tmp_path: Path
) -> None:
    refused, rule, printed_tip = last_line(run_program(_REFUSED, tmp_path, page, gpu=False))  # type: ignore[misc]
    assert f"web: {message}" in refused
    assert rule == DEVICE_DRIVER.id
    assert tip in printed_tip


_WAITS = """
import asyncio, json
import numpy as np
import rhi
from rhi.backends.web import request_device

def rule_of(call):
    try:
        call()
    except rhi.DeviceError as error:
        return error.rule.id

results = [rule_of(lambda: rhi.create_device("web"))]
device = rhi.create_device("web", device=await request_device())
buffer = device.buffer(np.arange(64, dtype=np.float32))
image = device.texture((8, 8), rhi.Format.RGBA8)
results += [rule_of(buffer.read), rule_of(image.read)]
awaited = [(await buffer.read_async()).tolist() == list(range(64))]
for green in (0, 51, 102):
    with device.render_pass(image, clear=(1, green / 255, 0, 1)):
        pass
    awaited.append((await image.read_async())[0, 0].tolist() == [255, green, 0, 255])
reads = [image.read_async() for _ in range(5)]
before = [read.done for read in reads]
await device.finish_async()
awaited += [not any(before), all(read.done for read in reads), reads[4].result()[7, 7, 1] == 102]
lost = device._core.backend.device._internal
lost.destroy()
await lost.lost
results += [rule_of(call) for call in (
    lambda: device.buffer(64, np.dtype("u1")), lambda: device.texture((4, 4), rhi.Format.RGBA8),
    lambda: buffer.write(np.zeros(64, np.float32)), buffer.read, device.finish)]
device.close()
print(json.dumps([results, [bool(each) for each in awaited]]))
"""


def test_without_jspi_reads_are_awaited_and_blocking_calls_are_refused(tmp_path: Path) -> None:
    results, awaited = last_line(run_program(_WAITS, tmp_path, jspi=False))  # type: ignore[misc]
    assert results == ["device-wait"] * 3 + ["device-lost"] * 5
    assert awaited == [True] * 7


_FAULTY = """
import json
import numpy as np
import rhi
from rhi.shading import Shader, StorageRW, native

class Broken(Shader):
    out: StorageRW[float]

    @native(
        "wgsl",
        '''
    let i = 1u;
    out[i] = sqrt(true);
        ''',
    )
    def compute(self) -> None:
        self.out[0] = 1.0

with rhi.create_device("web") as device:
    try:
        device.program(Broken)
    except rhi.ShaderError as error:
        shader = [error.rule.id, error.given, error.site.line]
    values = device.buffer(np.zeros(64, np.float32))
    backend = device._core.backend
    same = backend._buffers[values.id].object
    backend._stream.outside().copy_buffer_to_buffer(same, 0, same, 4, 8)
    try:
        values.read()
        driver = None
    except rhi.DeviceError as error:
        driver = error.rule.id
    values.write(np.arange(64, dtype=np.float32))
    right = values.read().tolist() == list(range(64))
print(json.dumps([shader, driver, right]))
"""


def test_errors_of_the_page_are_raised_by_name_and_later_commands_run(tmp_path: Path) -> None:
    (rule, message, line), driver, right = last_line(run_program(_FAULTY, tmp_path))  # type: ignore[misc]
    assert rule == "shader-driver"
    assert "out[i] = sqrt(true);" in message
    assert "sqrt(true)" in _FAULTY.splitlines()[line - 1]
    assert driver == DEVICE_DRIVER.id
    assert right


# -- images ------------------------------------------------------------------------------------------------

_DRAWS = """
import importlib, sys
import numpy as np
import rhi

folder, *names = sys.argv[1:]
with rhi.create_device() as device:
    assert device.backend_name == "web"
    for name in names:
        image = importlib.import_module(name).render(device, (200, 150)).read()
        np.save(f"/host{folder}/{name}.npy", image)
"""


def run_with_wgpu(text: str, folder: Path, *arguments: str) -> None:
    """Run the text of a program in a process in which wgpu draws by Dawn's driver, or skip the test."""
    environment = {
        "VK_ICD_FILENAMES": run_in_node.find_driver() or "",
        "RHI_WGPU_PROFILE": "core",
        "PYTHONPATH": f"{ROOT}:{ROOT / 'examples' / 'programs'}",
        "XDG_RUNTIME_DIR": str(folder),
    }
    done = subprocess.run(
        [sys.executable, "-c", text, *arguments],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
        encoding="utf-8",
    )
    if "No module named 'wgpu" in done.stderr or "[device-driver]" in done.stderr:
        pytest.skip("no wgpu on Dawn's driver")
    assert done.returncode == 0, done.stderr


def test_programs_draw_as_wgpu_does_on_the_same_driver(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No texel differs. Where wgpu has another driver than Dawn, the triangle alone is compared, with gl."""
    run_program(_DRAWS, tmp_path, str(tmp_path), *PROGRAMS)
    images = {name: np.load(tmp_path / f"{name}.npy") for name in PROGRAMS}
    monkeypatch.syspath_prepend(str(ROOT / "examples" / "programs"))
    with rhi.create_device("gl") as device:
        expected = importlib.import_module("triangle").render(device, SIZE).read()
    assert np.abs(images["triangle"].astype(int) - expected).max() <= 1
    reference = (
        "import importlib, sys, numpy as np, rhi\n"
        "with rhi.create_device('wgpu') as device:\n"
        "    for name in sys.argv[2:]:\n"
        "        image = importlib.import_module(name).render(device, (200, 150)).read()\n"
        "        np.save(f'{sys.argv[1]}/{name}-wgpu.npy', image)\n"
    )
    run_with_wgpu(reference, tmp_path, str(tmp_path), *PROGRAMS)
    differing = {
        name: int((images[name] != np.load(tmp_path / f"{name}-wgpu.npy")).sum()) for name in PROGRAMS
    }
    assert differing == dict.fromkeys(PROGRAMS, 0)


_REPEATED = """
import json
import rhi
from pyodide.code import run_js
from rhi.conformance.shaders import Tint, Tinted
from rhi.conformance.shapes import rectangle

reds, bundles = [], []
count = run_js('''(() => {
    let made = 0;
    const {finish} = GPURenderBundleEncoder.prototype;
    GPURenderBundleEncoder.prototype.finish = function(...values) { made += 1; return finish.apply(this, values); };
    return () => made;
})()''')
with rhi.create_device("web") as device:
    program, mesh = device.program(Tinted), device.mesh(rectangle())
    image = device.texture((8, 8), rhi.Format.RGBA8)
    for frame in range(6):
        with device.render_pass(image, clear=(0, 0, 0, 1)):
            for draw in range(60):
                device.draw(program, mesh, tint=Tint(color=((20 * frame + (draw == 59)) / 255, 0, 0, 1)))
        device.present()
        reds.append(int(image.read()[4, 4, 0]))
        bundles.append(count())
print(json.dumps([reds, bundles]))
"""


def test_frames_that_repeat_a_pass_have_their_own_values(tmp_path: Path) -> None:
    """The second frame makes bundles, and later ones use them."""
    reds, bundles = last_line(run_program(_REPEATED, tmp_path))  # type: ignore[misc]
    assert reds == [1, 21, 41, 61, 81, 101]
    assert bundles == [0, *[bundles[1]] * 5]
    assert bundles[1] > 0


# -- the renderer ------------------------------------------------------------------------------------------

TECHNIQUES = ("forward", "clustered", "deferred_plus")
_CITY = """
import json, sys
import numpy as np
import rhi
from renderer.content import load_scene, parse_camera
from renderer.renderer import Renderer

backend, folder, *techniques = sys.argv[1:]
statistics = {}
with rhi.create_device(backend) as device:
    for options in ("blocks=6", "blocks=6,shadows=1"):
        scene = load_scene(f"city:{options}")
        camera = parse_camera("ground", scene, frame=900)
        for technique in techniques:
            with Renderer(
                device, scene, technique=technique, visibility="frustum", size=(160, 90)
            ) as renderer:
                for _ in range(2):  # the second repeats recorded commands
                    result = renderer.render(camera, seconds=15.0)
                name = f"{technique}-{len(options)}"
                np.save(f"{folder}/{name}-{backend}.npy", result.image.read())
                statistics[name] = [result.statistics.draws, result.statistics.triangles]
print(json.dumps(statistics))
"""


def test_the_city_is_drawn_as_by_wgpu_on_the_same_driver_and_nearly_as_by_gl(tmp_path: Path) -> None:
    """No texel differs from wgpu. SwiftShader covers other pixels at edges than llvmpipe, and selects other
    mip levels, so gl is compared with a share of the pixels."""
    statistics = last_line(run_program(_CITY, tmp_path, "web", f"/host{tmp_path}", *TECHNIQUES))
    assert isinstance(statistics, dict)
    assert {draws for draws, _ in statistics.values()} == {statistics["forward-8"][0]} != {0}
    run_with_wgpu(_CITY, tmp_path, "wgpu", str(tmp_path), *TECHNIQUES)
    subprocess.run(
        [sys.executable, str(tmp_path / "program.py"), "gl", str(tmp_path), *TECHNIQUES],
        check=True,
        capture_output=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    for name in statistics:
        web, wgpu, gl = (
            np.load(tmp_path / f"{name}-{each}.npy").astype(int) for each in ("web", "wgpu", "gl")
        )
        assert (web != wgpu).sum() == 0, name
        assert (np.abs(web - gl).max(axis=-1) <= 2).mean() > 0.93, name
    lit, shadowed = (np.load(tmp_path / f"forward-{length}-web.npy").astype(int) for length in (8, 18))
    assert (np.abs(lit - shadowed).max(axis=-1) > 8).mean() > 0.05  # the shadows are seen


VISIBILITY = ("none", "frustum", "stop_and_wait", "chc", "chc_plus_plus", "depth_pyramid", "auto")
"""The visibility algorithms, but for those that need what this backend lacks."""
_SAVED = """
import json, sys
import numpy as np
import rhi
from renderer.content import load_scene, parse_camera
from renderer.renderer import Renderer

scene = load_scene(sys.argv[1])
camera = next(iter(scene.views.values()))
draws = {}
with rhi.create_device("web") as device:
    for visibility in sys.argv[2:]:
        with Renderer(device, scene, visibility=visibility, size=(160, 90)) as renderer:
            for _ in range(2):
                result = renderer.render(camera)
            image = result.image.read()[..., :3].astype(int)
        draws.setdefault("image", image)
        draws[visibility] = int(np.abs(image - draws["image"]).max())
print(json.dumps([float(draws.pop("image").std()), draws]))
"""


def test_a_saved_city_is_loaded_and_drawn_alike_with_all_visibility_algorithms(tmp_path: Path) -> None:
    """Images of files are decoded without threads, and indices of 64 bits are taken where pointers have 32."""
    path = tmp_path / "city.glb"
    save_scene(load_scene("city:blocks=4"), path)
    deviation, differences = last_line(  # type: ignore[misc]
        run_program(_SAVED, tmp_path, f"/host{path}", *VISIBILITY, packages=("numpy", "pillow"))
    )
    assert deviation > 20.0
    assert differences == dict.fromkeys(VISIBILITY, 0)


_TIMES = """
import json
import rhi
device = rhi.create_device("web", timing=True)
image = device.texture((512, 512), rhi.Format.RGBA8)
for _ in range(2):
    with device.event("frame"):
        for _ in range(4):
            with device.render_pass(image, clear=(0, 0, 0, 1)):
                pass
    with device.event("nothing"):
        pass
    device.present()
device.finish()
print(json.dumps([device.capabilities.timestamps, [[n.name, n.gpu_milliseconds] for n in device.timers]]))
"""


def test_events_have_times_of_the_gpu(tmp_path: Path) -> None:
    has_timestamps, times = last_line(run_program(_TIMES, tmp_path))  # type: ignore[misc]
    assert has_timestamps
    (frame, duration), (nothing, least) = times
    assert (frame, nothing) == ("frame", "nothing")
    assert 0.0 <= least < duration


# -- the conformance kit -----------------------------------------------------------------------------------


def test_the_kit_passes() -> None:
    done = run_kit("web", "-k", f"not ({' or '.join(ENDLESS)})")
    assert check_kit(done.stdout + done.stderr, EXPECTED_FAILURES) > 3000
