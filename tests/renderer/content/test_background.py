"""Scenes that a thread loads: progress, errors, cancelling, the end of threads, and frames meanwhile."""

import io
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from gltf_documents import GltfDocument
from nightly_reasons import ONLY_KERNELS
from PIL import Image

from renderer.content import BackgroundLoad, load_scene
from renderer.content.background import STEPS
from renderer.content.progress import report, watch_progress
from renderer.frame import UploadSettings
from renderer.renderer import Renderer
from rhi import RhiError
from tests.renderer.refusals import refused_rule

SIZE = (64, 48)
SECONDS = 60.0


def write_model(folder, images=6, size=64):
    """Write triangles in a row, each with an image of its own; return the file's path."""
    document = GltfDocument(nodes=[])
    rng = np.random.default_rng(images)
    uv = np.float32([[0, 0], [1, 0], [0, 1]])
    for number in range(images):
        file = io.BytesIO()
        Image.fromarray(rng.integers(0, 255, (size, size, 3), np.uint8)).save(file, "PNG")
        image = document.add("images", bufferView=document.view(file.getvalue()), mimeType="image/png")
        texture = {"index": document.add("textures", source=image)}
        pbr = {"baseColorTexture": texture, "metallicFactor": 0}
        material = document.add("materials", pbrMetallicRoughness=pbr, doubleSided=True)
        corners = np.float32([[0, 0, 0], [1, 0, 0], [0, 1 + number / 10, 0]])
        mesh = document.mesh(corners, TEXCOORD_0=uv, material=material)
        document.add("nodes", mesh=mesh, translation=[1.2 * number, 0, 0])
    return document.write(folder / "row.glb")


@pytest.fixture
def model(tmp_path):
    return write_model(tmp_path)


def test_a_loaded_scene_equals_one_that_was_waited_for(model):
    load = BackgroundLoad(f"{model}:scale=2")
    scene, expected = load.wait(SECONDS), load_scene(f"{model}:scale=2")
    assert load.is_done
    assert load.join(SECONDS)
    assert scene.name == expected.name
    assert np.array_equal(scene.meshes.vertices, expected.meshes.vertices)
    assert np.array_equal(scene.nodes.world, expected.nodes.world)
    assert all(map(np.array_equal, scene.images, expected.images))
    assert load.poll() is scene


def test_progress_grows_through_all_steps_to_1(model, monkeypatch):
    noted, original = [], BackgroundLoad._note

    def note(self, step, fraction):
        original(self, step, fraction)
        noted.append(self.progress)

    monkeypatch.setattr(BackgroundLoad, "_note", note)
    load = BackgroundLoad(model)
    load.wait(SECONDS)
    fractions = [progress.fraction for progress in noted]
    assert fractions == sorted(fractions)
    assert list(dict.fromkeys(progress.step for progress in noted)) == list(STEPS)
    assert sum(progress.step == "images" for progress in noted) == 6
    assert sum(progress.step == "meshes" for progress in noted) == 6
    assert (load.progress.fraction, load.progress.step) == (1.0, "")


def test_nothing_is_reported_where_nobody_watches(model):
    report("meshes", 1, 2)
    noted = []
    with watch_progress(lambda step, fraction: noted.append((step, fraction))):
        report("meshes", 1, 2)
    report("meshes", 2, 2)
    assert noted == [("meshes", 0.5)]


def test_frames_go_on_while_a_scene_is_loaded(null):
    gate = threading.Event()

    def build():
        assert gate.wait(SECONDS)
        return load_scene("grid:count=9")

    load = BackgroundLoad(build)
    first = load_scene("grid:count=1")
    with Renderer(null, first, size=SIZE) as renderer:
        for _ in range(3):
            renderer.render(next(iter(first.views.values())))
            assert load.poll() is None
            assert load.wait(0.001) is None
    gate.set()
    assert len(load.wait(SECONDS).objects) >= 9


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("nowhere.glb", "scene-missing-file"),
        ("cyti", "scene-unknown-scene"),
        ("city:blocks=0", "scene-bad-value"),
        ("{model}:scale=0", "scene-bad-import"),
        ("{folder}/broken.glb", "scene-unreadable-model"),
    ],
)
def test_errors_reach_the_caller_by_name(model, tmp_path, text, rule):
    (tmp_path / "broken.glb").write_bytes(b"glTF but no more")
    load = BackgroundLoad(text.format(model=model, folder=tmp_path))
    assert refused_rule(lambda: load.wait(SECONDS)) == rule
    assert refused_rule(load.poll) == rule
    assert load.join(SECONDS)


def test_other_errors_reach_the_caller_as_they_are():
    load = BackgroundLoad(lambda: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        load.wait(SECONDS)


@pytest.mark.parametrize("step", STEPS)
def test_a_cancelled_load_stops_at_the_next_part(model, step, monkeypatch):
    reached, gate = threading.Event(), threading.Event()
    original = BackgroundLoad._note

    def note(self, current, fraction):
        if current == step:
            reached.set()
            assert gate.wait(SECONDS)
        original(self, current, fraction)

    monkeypatch.setattr(BackgroundLoad, "_note", note)
    before = set(threading.enumerate())
    load = BackgroundLoad(model)
    assert reached.wait(SECONDS)
    load.cancel()
    assert not load.is_done
    gate.set()
    assert refused_rule(lambda: load.wait(SECONDS)) == "scene-load-cancelled"
    assert load.join(SECONDS)
    assert load.progress.fraction < 1.0
    assert set(threading.enumerate()) <= before


def test_cancelling_a_scene_that_is_there_changes_nothing(model):
    load = BackgroundLoad(model)
    scene = load.wait(SECONDS)
    load.cancel()
    assert load.poll() is scene


def test_several_scenes_are_loaded_at_once(model):
    loads = [BackgroundLoad(f"{model}:scale={number}") for number in (1, 2, 3)]
    widths = [np.ptp(load.wait(SECONDS).bounds, axis=0)[0] for load in loads]
    assert np.allclose(widths, widths[0] * np.array([1, 2, 3]))


@pytest.mark.parametrize("least", [-1.0, 0.0], ids=["at once", "in the middle"])
def test_threads_end_when_the_interpreter_exits(tmp_path, least):
    model = write_model(tmp_path, images=24, size=700)
    program = (
        "import time\nfrom renderer.content import BackgroundLoad\n"
        f"load = BackgroundLoad({model!r})\nwhile load.progress.fraction <= {least}:\n    time.sleep(0.001)\n"
        "print(load.is_done)\n"
    )
    began = time.monotonic()
    run = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        check=False,
        timeout=SECONDS,
        encoding="utf-8",
    )
    assert (run.returncode, run.stdout, run.stderr) == (0, "False\n", "")
    assert time.monotonic() - began < SECONDS


@pytest.mark.nightly_cases("cl*", reason=ONLY_KERNELS)
def test_the_final_image_equals_that_of_a_scene_loaded_and_uploaded_at_once(drawing_device, tmp_path):
    model = write_model(tmp_path, images=4, size=256)
    scene = load_scene(model)
    camera = scene.views["overview"].with_aspect(SIZE[0] / SIZE[1])
    with Renderer(drawing_device, scene, size=SIZE) as renderer:
        expected = renderer.render(camera).image.read()
    loaded = BackgroundLoad(model).wait(SECONDS)
    with Renderer(drawing_device, loaded, size=SIZE, uploads=UploadSettings(1 << 18)) as renderer:
        first = renderer.render(camera).image.read()
        while not renderer.uploads.is_done:
            renderer.render(camera)
        last = renderer.render(camera).image.read()
    assert np.array_equal(last, expected)
    assert not np.array_equal(first, expected)


def test_an_error_that_is_polled_twice_is_the_same():
    load = BackgroundLoad("nowhere.glb")
    with pytest.raises(RhiError) as first:
        load.wait(SECONDS)
    with pytest.raises(RhiError) as second:
        load.poll()
    assert first.value is second.value
