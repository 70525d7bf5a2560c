"""Files saved while a viewer runs: shaders, scenes and settings are exchanged; what is wrong stays in the
image."""

from __future__ import annotations

import importlib
import itertools
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("watchfiles", reason="no watchfiles: pip install rhi[viewer]")

from refusals import refused_message

import rhi
from renderer.content import load_scene, save_scene
from renderer.content.shapes import box
from renderer.frame import Blending, Frame
from renderer.scene import Depth, SceneBuilder
from renderer.settings import RenderSettings
from renderer.viewer import DisplaySettings, Viewer
from renderer.viewer.viewer_screen import open_viewer
from renderer.visibility import NoCulling
from tests.renderer.conftest import open_device

SIZE = (48, 32)
TEXT = """
from __future__ import annotations
from rhi.shading import Shader, vec4, vertex_index

RED = 1.0

class Corner(Shader):
    '''A triangle over the upper left half of the image.'''

    def vertex(self) -> vec4:
        return vec4(-1.0 + 4.0 * float(vertex_index() >> 1), 1.0 - 4.0 * float(vertex_index() & 1), 0.5, 1.0)

    def fragment(self) -> vec4:
        return vec4(RED, 0.0, 1.0, 1.0)
"""
_numbers = itertools.count()


class CornerLayer:
    """Draws the shader of a module over the image, as a program does that has shaders of its own."""

    def __init__(self, device: rhi.Device, module: Any) -> None:
        self._program: Any = device.program(module.Corner)
        self._mesh = device.mesh(3)

    def render(self, device: rhi.Device, frame: Frame) -> None:
        with device.render_pass(frame.targets.image):
            device.draw(self._program, self._mesh)

    def destroy(self) -> None:
        pass


def save(path: Path, text: str) -> None:
    """Save as most editors do, beside the file and then in its place."""
    beside = path.with_name(f"{path.name}~")
    beside.write_text(text, encoding="utf-8")
    os.replace(beside, path)


def settle(viewer: Viewer, done: Callable[[], object]) -> None:
    """Draw frames until something is so."""
    until = time.monotonic() + 20.0
    while not done():
        assert time.monotonic() < until, "nothing happened"
        time.sleep(0.01)
        viewer.draw()


def console_lines(viewer: Viewer) -> list[str]:
    return [line for line, is_error in viewer.console.lines if is_error]


def fault_lines(viewer: Viewer) -> list[str]:
    """The errors in the image."""
    return [line for line, is_error in viewer._interface.state.notes if is_error]


@pytest.fixture
def shaders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(str(tmp_path))
    name = f"saved_shaders_{next(_numbers)}"
    (tmp_path / f"{name}.py").write_text(TEXT, encoding="utf-8")
    importlib.invalidate_caches()
    yield importlib.import_module(name)
    del sys.modules[name]


@pytest.fixture
def viewer(null: rhi.Device) -> Iterator[Viewer]:
    """A viewer whose clock goes on by a minute a frame, so that what is only noted isn't seen any more."""
    times = itertools.count(0.0, 60.0)
    opened = Viewer(null, load_scene("grid:count=9"), size=SIZE, clock=lambda: next(times))
    opened.file_reloader.watch(True)
    yield opened
    opened.close()


@pytest.mark.parametrize("backend", ["gl", "cl"])
def test_a_saved_shader_is_in_the_next_frame_and_a_faulty_one_isnt(backend: str, shaders: Any) -> None:
    path = Path(shaders.__file__)
    with open_device(backend) as device:
        viewer = Viewer(device, load_scene("grid:count=9"), size=SIZE)
        viewer._interface.is_hidden = True
        viewer.session.renderer.layers.append(CornerLayer(device, shaders))
        viewer.file_reloader.watch(True)

        def red() -> int:
            return int(viewer.draw().read()[4, 4, 0])  # of sRGB

        assert red() == 255
        save(path, TEXT.replace("RED = 1.0", "RED = 0.2"))
        settle(viewer, lambda: red() == 124)
        save(path, TEXT.replace("vec4(RED", "vec4(RAD"))
        settle(viewer, lambda: viewer.file_reloader.faults)
        assert red() == 124
        save(path, TEXT.replace("RED = 1.0", "RED = 0.4"))
        settle(viewer, lambda: red() == 170)
        assert viewer.file_reloader.faults == []
        viewer.close()


def test_a_faulty_shader_is_named_in_the_frame_for_as_long_as_it_is(viewer: Viewer, shaders: Any) -> None:
    viewer.session.renderer.layers.append(CornerLayer(viewer.session.renderer.device, shaders))
    path = Path(shaders.__file__)
    viewer.draw()
    save(path, TEXT.replace("vec4(RED", "vec4(RAD"))
    settle(viewer, lambda: viewer.file_reloader.faults)
    number = next(n for n, line in enumerate(TEXT.splitlines(), 1) if "vec4(RED" in line)
    for _ in range(3):
        viewer.draw()
        assert any(f"{path}:{number}:" in line for line in fault_lines(viewer))
        assert any("return vec4(RAD, 0.0, 1.0, 1.0)" in line for line in fault_lines(viewer))
    assert any(f"{path}:{number}:" in line for line in console_lines(viewer))
    save(path, TEXT.replace("RED = 1.0", "RED = 0.5"))
    settle(viewer, lambda: not viewer.file_reloader.faults)
    viewer.draw()
    assert fault_lines(viewer) == []


def test_carets_are_below_the_code_that_they_mark(viewer: Viewer, shaders: Any) -> None:
    viewer.session.renderer.layers.append(CornerLayer(viewer.session.renderer.device, shaders))
    viewer.draw()
    save(Path(shaders.__file__), TEXT.replace("vec4(RED", "vec4(RAD"))
    settle(viewer, lambda: viewer.file_reloader.faults)
    viewer.draw()
    lines, canvas = fault_lines(viewer), viewer._interface._canvas
    number = next(n for n, line in enumerate(lines) if "^" in line)
    source, carets = lines[number - 1], lines[number]
    first, end = carets.index("^"), carets.rindex("^") + 1
    assert "RAD" in source[first:end]
    for column in (first, end):
        assert canvas.measure(source[:column]) == canvas.measure(carets[:column])


def test_a_shader_with_which_no_frame_can_be_drawn_is_put_back(viewer: Viewer, shaders: Any) -> None:
    viewer.session.renderer.layers.append(CornerLayer(viewer.session.renderer.device, shaders))
    viewer.draw()
    text = TEXT.replace("import Shader", "import Shader, Uniform").replace("vec4(RED", "vec4(self.more")
    save(Path(shaders.__file__), text.replace("    '''A", "    more: Uniform[float]\n    '''A"))
    settle(viewer, lambda: viewer.file_reloader.faults)
    assert any("binding-missing" in line for line in console_lines(viewer))
    assert shaders.Corner._declared == {}
    viewer.draw()
    assert any("binding-missing" in line for line in fault_lines(viewer))
    assert len(viewer.session.renderer.layers) == 2, "the frame was drawn as before"


def test_nothing_is_exchanged_after_reload_off(viewer: Viewer, shaders: Any) -> None:
    viewer.draw()
    assert viewer.run("reload off") == ("reload off", False)
    save(Path(shaders.__file__), TEXT.replace("RED = 1.0", "RED = 0.5"))
    for _ in range(20):
        time.sleep(0.01)
        viewer.draw()
    assert shaders.RED == 1.0
    assert viewer.run("reload") == ("reload on", False)
    save(Path(shaders.__file__), TEXT.replace("RED = 1.0", "RED = 0.25"))
    settle(viewer, lambda: shaders.RED == 0.25)


def test_whoever_shows_the_viewer_is_woken_by_a_save(viewer: Viewer, shaders: Any) -> None:
    woken: list[bool] = []
    viewer.file_reloader.wake = lambda: woken.append(True)
    viewer.draw()
    save(Path(shaders.__file__), TEXT + "# more")
    until = time.monotonic() + 20.0
    while not woken and time.monotonic() < until:
        time.sleep(0.01)
    assert woken


MATERIAL = """
from renderer.shaders.materials import MaterialShader
from renderer.shaders.structs import SurfaceInput, SurfaceParameters
from rhi.shading import vec4

class Painted(MaterialShader):
    def describe(self, at: SurfaceInput) -> SurfaceParameters:
        found = super().describe(at)
        found.color = vec4(1.0, 0.5, 0.0, 1.0)
        return found
"""


def test_a_viewer_that_begins_with_a_faulty_shader_shows_the_last_good_one_and_the_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    monkeypatch.setenv("RHI_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # the file is changed within a second
    monkeypatch.syspath_prepend(str(tmp_path))

    def begin(text: str) -> Viewer:
        """Open a viewer as a new process does."""
        (tmp_path / "painted.py").write_text(text, encoding="utf-8")
        monkeypatch.delitem(sys.modules, "painted", raising=False)
        builder = SceneBuilder("painted")
        material = builder.add_material(shader=importlib.import_module("painted").Painted)
        builder.add_objects(builder.add_node(np.eye(4)), builder.add_mesh(box()), material)
        viewer_screen = open_viewer(builder.build(), "gl", canvas="offscreen", size=SIZE)
        request.addfinalizer(viewer_screen.close)
        viewer_screen.viewer.draw()
        return viewer_screen.viewer

    with pytest.raises(rhi.ShaderError):
        begin(MATERIAL.replace("0.5", "green"))
    good = begin(MATERIAL).session.screenshot()
    viewer = begin(MATERIAL.replace("0.5", "green"))
    assert any(f"{tmp_path / 'painted.py'}:9:" in line for line in fault_lines(viewer))
    assert np.array_equal(viewer.session.screenshot(), good)


def test_without_watchfiles_the_console_names_the_package_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "watchfiles", None)
    viewer_screen = open_viewer("grid:count=9", "null", canvas="offscreen", size=SIZE)
    line, is_error = viewer_screen.viewer.console.lines[-1]
    assert ("watchfiles is missing" in line, 'pip install "rhi[viewer]"' in line, is_error) == (
        True,
        True,
        False,
    )
    assert not viewer_screen.viewer.file_reloader.is_watching
    assert viewer_screen.viewer.run("reload on")[1]
    viewer_screen.viewer.draw()
    viewer_screen.close()


# -- scenes --------------------------------------------------------------------------------------------------


@pytest.fixture
def model(tmp_path: Path, null: rhi.Device) -> Iterator[tuple[Path, Viewer]]:
    path = tmp_path / "blocks.gltf"
    save_scene(load_scene("grid:count=9"), path)
    times = itertools.count(0.0, 60.0)
    viewer = Viewer(null, load_scene(str(path)), size=SIZE, clock=lambda: next(times))
    viewer.file_reloader.watch(True)
    yield path, viewer
    viewer.close()


def edit(path: Path, change: Callable[[Any], None]) -> None:
    document = json.loads(path.read_text(encoding="utf-8"))
    change(document)
    save(path, json.dumps(document))


def paint(document: Any) -> None:
    for material in document["materials"]:
        material["pbrMetallicRoughness"]["baseColorFactor"] = [0.125, 0.25, 0.5, 1.0]


def test_a_saved_material_is_seen_from_the_same_position(model: tuple[Path, Viewer]) -> None:
    path, viewer = model
    viewer.run("camera 1,2,9,0,0,0")
    viewer.run("technique deferred")
    viewer.draw()
    assert "m away" in viewer.run("pick")[0]
    before, camera, device = viewer.session.scene, viewer.session.camera, viewer.session.renderer.device
    edit(path, paint)
    settle(viewer, lambda: viewer.session.scene is not before)
    assert np.allclose(viewer.session.scene.materials["base_color"][:, :3], (0.125, 0.25, 0.5))
    assert np.array_equal(viewer.session.camera.view, camera.view)
    assert (viewer.session.display.technique, viewer.session.hit, viewer.session.renderer.device) == (
        "deferred",
        None,
        device,
    )
    viewer.draw()
    assert "m away" in viewer.run("pick")[0]


def test_a_scene_with_other_options_is_seen_from_here(model: tuple[Path, Viewer]) -> None:
    viewer = model[1]
    for line in ("scene grid:count=9", "camera 1,2,9,0,0,0"):
        viewer.run(line)
    camera = viewer.session.camera.view.tolist()
    assert viewer.run("scene lights=5,count=4")[0].startswith("grid:lights=5,mesh=torus,count=4,")
    scene = viewer.session.scene
    assert (len(scene.objects.node), len(scene.lights.point)) == (4, 5)
    assert viewer.run("scene light=6")[1]
    assert (viewer.session.camera.view.tolist(), viewer.session.scene) == (camera, scene)


SCENES_OF_COUNTS = [("grid", 4), ("bazaar", 700), ("glass", 5)]


@pytest.mark.parametrize("scene", [scene for scene, _ in SCENES_OF_COUNTS])
def test_lights_are_shown_in_another_number(model: tuple[Path, Viewer], scene: str) -> None:
    viewer = model[1]
    viewer.run(f"scene {scene}:lights=3")
    message, is_error = viewer.run("lights 12")
    lights = viewer.session.scene.lights
    assert (len(lights.point) + len(lights.spot), is_error) == (12, False)
    assert message.startswith(
        f"{len(lights)} lights: {len(lights.directional)} directional, {len(lights.point)} point, "
    )
    assert viewer.run("lights") == (message, False)


def test_lights_that_reach_the_view_are_counted(model: tuple[Path, Viewer]) -> None:
    viewer = model[1]
    viewer.run("scene grid:lights=3")
    viewer.run("camera field")
    assert viewer.run("lights 12")[0].endswith("of the last two 12 reach what is in view")
    viewer.run("camera 0,1,9000,0,1,9001")
    assert viewer.run("lights")[0].endswith("of the last two 0 reach what is in view")


@pytest.mark.parametrize(("scene", "count"), SCENES_OF_COUNTS)
def test_objects_are_shown_in_another_number(model: tuple[Path, Viewer], scene: str, count: int) -> None:
    viewer = model[1]
    viewer.run(f"scene {scene}:lights=3")
    before = len(viewer.session.scene.objects.node)
    assert viewer.run(f"objects {count}")[1] is False
    after = len(viewer.session.scene.objects.node)
    assert after != before
    assert after == count or scene != "grid"  # other scenes have more objects than the number sets
    assert viewer.run("objects") == (f"{after} objects, {after} of them not hidden", False)


def test_a_number_of_objects_is_refused_where_none_can_be_set(model: tuple[Path, Viewer]) -> None:
    viewer = model[1]
    viewer.run("scene hall")
    before = viewer.session.scene
    for line in ("objects 5", "objects -1", "lights x"):
        assert viewer.run(line)[1]
    assert viewer.session.scene is before


def test_another_scene_is_seen_from_its_first_view_and_has_other_files(model: tuple[Path, Viewer]) -> None:
    path, viewer = model
    viewer.run("scene glass")
    scene = viewer.session.scene
    assert np.array_equal(viewer.session.camera.position, next(iter(scene.views.values())).position)
    edit(path, paint)
    for _ in range(20):
        time.sleep(0.01)
        viewer.draw()
    assert viewer.session.scene is scene


def test_buffers_beside_a_scene_are_watched_too(model: tuple[Path, Viewer]) -> None:
    path, viewer = model
    assert [file.name for file in viewer.session.scene.files] == ["blocks.gltf", "blocks.bin"]
    before, buffer = viewer.session.scene, path.with_suffix(".bin")
    buffer.write_bytes(buffer.read_bytes())
    settle(viewer, lambda: viewer.session.scene is not before)


def test_a_missing_texture_is_seen_when_it_appears(model: tuple[Path, Viewer]) -> None:
    path, viewer = model

    def ask(document: Any) -> None:
        document["images"] = [{"uri": "late.png"}, {"uri": "no folder/never.png"}]
        document["textures"] = [{"source": 0}, {"source": 1}]
        for number, material in enumerate(document["materials"]):
            material["pbrMetallicRoughness"]["baseColorTexture"] = {"index": min(number, 1)}

    before = viewer.session.scene
    edit(path, ask)
    settle(viewer, lambda: viewer.session.scene is not before)
    bare = viewer.session.scene
    assert len(bare.images) == 0
    assert not viewer.file_reloader.faults
    Image.new("RGB", (4, 4), (255, 128, 0)).save(path.with_name("late.png"))
    settle(viewer, lambda: viewer.session.scene is not bare and len(viewer.session.scene.images))
    assert "read late.png again" in [line for line, _ in viewer.console.lines]


@pytest.mark.parametrize("fault", ["syntax", "device"])
def test_a_scene_that_cannot_be_shown_leaves_the_old_one(
    model: tuple[Path, Viewer], fault: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, viewer = model
    viewer.draw()
    good, before = path.read_text(encoding="utf-8"), viewer.session.scene
    if fault == "syntax":
        save(path, good[:-9])
    else:
        monkeypatch.setattr(viewer.session, "_draw_offscreen", lambda renderer: 1 / 0)
        edit(path, paint)
    settle(viewer, lambda: viewer.file_reloader.faults)
    assert viewer.session.scene is before
    viewer.draw()
    assert any(
        {"syntax": "blocks.gltf", "device": "ZeroDivisionError"}[fault] in line
        for line in fault_lines(viewer)
    )
    monkeypatch.undo()
    save(path, good)
    settle(viewer, lambda: viewer.session.scene is not before)
    viewer.draw()
    assert fault_lines(viewer) == []


def test_scenes_that_are_exchanged_leave_nothing_behind(model: tuple[Path, Viewer]) -> None:
    path, viewer = model
    viewer.draw()
    stream = viewer.session.renderer.device.stream

    def count() -> int:
        kinds = [command.op.name for command in stream]
        return sum(name.startswith("CREATE") for name in kinds) - kinds.count("DESTROY")

    seen = []
    for number in range(3):
        edit(path, lambda document, n=number: document["materials"][0].update(name=f"material {n}"))
        settle(viewer, lambda n=number + 1: viewer.file_reloader._reloader.reloaded == n)
        viewer.session.renderer.device.finish()
        seen.append(count())
    assert seen[1] == seen[2]


def test_generated_and_built_scenes_have_no_files(tmp_path: Path) -> None:
    assert load_scene("grid:count=9").files == ()


# -- settings ------------------------------------------------------------------------------------------------


def test_settings_are_read_written_and_read_again_when_they_are_saved(viewer: Viewer, tmp_path: Path) -> None:
    path = tmp_path / "settings.json"
    viewer.run("technique deferred")
    viewer.run("visibility none")
    assert viewer.run(f"save settings {path}") == (f"wrote {path}", False)
    assert RenderSettings.load(path) == viewer.session.display.settings
    viewer.run("technique clustered")
    line, is_error = viewer.run(f"settings {path}")
    assert (line, is_error) == (f"read {path}: deferred, none", False)
    viewer.draw()
    changed = (
        RenderSettings.load(path).change("technique.name", "light_pre_pass").change("depth", Depth.STANDARD)
    )
    changed.change("textures.anisotropy", 4.0).save(path)
    settle(viewer, lambda: viewer.session.display.technique == "light_pre_pass")
    viewer.draw()
    assert viewer.session._last_camera.projection.depth is Depth.STANDARD
    assert viewer.session.renderer.technique.name == "light_pre_pass"
    path.write_text("{", encoding="utf-8")
    settle(viewer, lambda: viewer.file_reloader.faults)
    assert viewer.session.display.technique == "light_pre_pass"


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("settings missing.json", "No such file"),
        ("settings", "0 arguments"),
        ("save settings", "1 arguments"),
        ("save camera x.json", "did you mean settings"),
        ("save settings x.png", "ends with .json"),
    ],
)
def test_a_refused_settings_command_changes_nothing(
    viewer: Viewer, line: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert says in refused_message(viewer.run, line)
    assert viewer.session.display == DisplaySettings()
    assert list(tmp_path.iterdir()) == []


def test_every_setting_reaches_the_renderer(null: rhi.Device, tmp_path: Path) -> None:
    settings = RenderSettings().change_all(
        {
            "technique.name": "clustered",
            "technique.clusters.slices": 7,
            "algorithm": "none",
            "shadows.cascades": 2,
            "tessellation.edge_pixels": 20.0,
            "blending": Blending.WEIGHTED,
            "precision": rhi.shading.Precision.EXACT,
            "depth": Depth.STANDARD,
        }
    )
    path = tmp_path / "settings.json"
    settings.save(path)
    viewer_screen = open_viewer("grid:count=9", "null", canvas="offscreen", size=SIZE, settings=path)
    viewer, renderer = viewer_screen.viewer, viewer_screen.viewer.session.renderer
    viewer.draw()
    assert viewer.session.display.settings == settings
    assert (renderer.shadows.settings, renderer.tessellator.settings) == (
        settings.shadows,
        settings.tessellation,
    )
    assert (renderer.precision, type(renderer.visibility)) == (settings.precision, NoCulling)
    assert viewer.session._last_camera.projection.depth is Depth.STANDARD
    viewer_screen.close()
