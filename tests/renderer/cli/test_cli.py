"""The command line: its output, its files and its error messages."""

from __future__ import annotations

import io
import json
import logging
import subprocess
import sys
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from gltf_documents import TRIANGLE, GltfDocument
from matplotlib.figure import Figure
from nightly_reasons import CHEAPER_TEST
from PIL import Image

import rhi
from renderer.__main__ import run
from renderer.cli import main
from renderer.cli.compare_light_culling import plot_tests

KEYS = [
    "backend",
    "device",
    "scene",
    "size",
    "frames",
    "technique",
    "reason",
    "milliseconds",
    "triangles",
    "draws",
    "queries",
    "software_state_changes",
    "hardware_state_changes",
    "simulation_steps",
    "skipped_simulations",
    "uploads_bytes",
    "image_bytes",
    "image",
]
CITY = "city:blocks=4"


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Run in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("RHI_BACKEND", raising=False)
    return tmp_path


def run_json(capsys: pytest.CaptureFixture[str], *arguments: str, command: str = "render") -> dict[str, Any]:
    assert main([command, *arguments, "--json"]) == 0
    report: dict[str, Any] = json.loads(capsys.readouterr().out)
    return report


class Terminal(io.StringIO):
    """Stands in for stderr when it is a terminal."""

    def isatty(self) -> bool:
        return True


def test_a_terminal_shows_how_far_a_first_run_is_with_building_kernels(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    logger = logging.getLogger("rhi.kernels")
    monkeypatch.setattr(logger, "handlers", [])
    monkeypatch.setattr(logger, "level", logging.NOTSET)
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    assert main(["scenes"]) == main(["scenes"]) == 0
    logger.info("building kernels, %d of %d", 1, 3)
    assert terminal.getvalue() == "\r\x1b[Kbuilding kernels, 1 of 3"
    logger.info("building kernels, %d of %d", 3, 3)
    assert terminal.getvalue().endswith("\r\x1b[K")
    logger.warning("the program has waited")
    assert terminal.getvalue().endswith("\r\x1b[Kthe program has waited\n")


def test_elsewhere_nothing_is_shown_of_building_kernels(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scenes"]) == 0
    logging.getLogger("rhi.kernels").info("building kernels, %d of %d", 1, 3)
    assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("gl")
def test_render_writes_an_image_and_reports_it(capsys: pytest.CaptureFixture[str], here: Path) -> None:
    report = run_json(capsys, CITY, "--size", "80x60", "--backend", "gl", "--output", "new/image.png")
    assert list(report) == KEYS
    assert report["backend"] == "gl"
    assert report["size"] == [80, 60]
    assert report["frames"] == 1
    assert report["milliseconds"]["min"] == report["milliseconds"]["median"] > 0
    assert report["image"] == str(Path("new/image.png"))
    image = np.asarray(Image.open(here / "new/image.png"))
    assert image.shape == (60, 80, 3)
    assert image.std() > 10


@pytest.mark.usefixtures("gl")
def test_without_an_output_the_image_has_the_scenes_name(
    capsys: pytest.CaptureFixture[str], here: Path
) -> None:
    report = run_json(capsys, CITY, "--size", "16x16")
    assert report["image"] == "city.png"
    assert (here / "city.png").exists()


def test_the_null_device_makes_no_image_and_says_so(capsys: pytest.CaptureFixture[str], here: Path) -> None:
    assert main(["render", CITY, "--backend", "null", "--json"]) == 0
    output = capsys.readouterr()
    report = json.loads(output.out)
    assert list(report) == KEYS
    assert report["image"] is None
    assert report["draws"] > 0
    assert "no image" in output.err
    assert not list(here.iterdir())


def test_frames_of_a_path_are_summed_up(capsys: pytest.CaptureFixture[str]) -> None:
    report = run_json(
        capsys, CITY, "--backend", "null", "--camera", "ground", "--frame", "10", "--frames", "4"
    )
    assert report["frames"] == 4
    times = report["milliseconds"]
    assert times["min"] <= times["median"] <= times["max"]


def test_the_option_visibility_changes_the_number_of_draws(capsys: pytest.CaptureFixture[str]) -> None:
    draws = [
        run_json(capsys, CITY, "--backend", "null", "--camera", "street", "--visibility", visibility)["draws"]
        for visibility in ("none", "frustum")
    ]
    assert draws[0] > draws[1]


def test_render_prints_the_memory_of_images(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_json(capsys, CITY, "--backend", "null")["image_bytes"] > 100_000
    assert run_json(capsys, "grid:count=4", "--backend", "null")["image_bytes"] == 0


def test_without_json_the_same_values_are_printed_as_lines(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["render", CITY, "--backend", "null"]) == 0
    names = [line.partition(":")[0].replace(" ", "_") for line in capsys.readouterr().out.splitlines()]
    printed_names = {"uploads_bytes": "bytes_uploaded", "image_bytes": "bytes_of_images"}
    assert names == [printed_names.get(key, key) for key in KEYS]


def test_the_environment_names_the_backend(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RHI_BACKEND", "null")
    assert run_json(capsys, CITY)["backend"] == "null"


@pytest.mark.parametrize("depth", ["reversed", "standard"])
def test_depth_runs_as_asked(capsys: pytest.CaptureFixture[str], depth: str) -> None:
    changes = run_json(capsys, CITY, "--backend", "null", "--depth", depth, "--frames", "2")
    assert changes["draws"] > 0


def write_model(folder: Path, vertex: str) -> str:
    path = folder / "model.obj"
    path.write_text(f"v {vertex}\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", encoding="utf-8")
    return str(path)


def test_a_model_file_is_rendered(capsys: pytest.CaptureFixture[str], here: Path) -> None:
    report = run_json(capsys, write_model(here, "0 0 0"), "--backend", "null")
    assert report["triangles"] == 1


LEFT_OUT = "left out: vertex attribute _DUST (meshes[0].primitives[0].attributes)"


def write_dusty(path: Path) -> dict[str, object]:
    """Write a model file with a triangle, and an attribute that isn't read; return how that is listed."""
    document = GltfDocument(nodes=[{"mesh": 0}])
    document.mesh(_DUST=TRIANGLE)
    document.write(path)
    return {"what": "vertex attribute _DUST", "count": 1, "where": "meshes[0].primitives[0].attributes"}


@pytest.mark.parametrize(
    "command",
    [
        "render dusty.gltf --backend null --size 64x36",
        "capture dusty.gltf --backend null --size 64x36 --frames 1 --output dusty.csv",
        "compare visibility dusty.gltf --backend null --size 64x36 --camera-path sky --frames 1 --algorithms "
        "none",
        "compare techniques dusty.gltf --backend null --size 64x36 --rounds 1 --techniques forward",
        "compare stereo dusty.gltf --backend null --sizes 64x36 --camera-path sky --frame 0 --frames 1 "
        "--shadows off,on",
    ],
    ids=lambda command: command.partition(" dusty")[0],
)
def test_extensions_of_a_file_that_the_scene_leaves_out_are_listed_once(
    capsys: pytest.CaptureFixture[str], here: Path, command: str
) -> None:
    listed = write_dusty(here / "dusty.gltf")
    main([*command.split(), "--json"])
    output = capsys.readouterr()
    assert output.err.splitlines().count(LEFT_OUT) == 1
    assert json.loads(output.out)["left_out"] == [listed]


@pytest.mark.usefixtures("gl")
def test_accuracy_lists_it_and_charts_are_drawings(capsys: pytest.CaptureFixture[str], here: Path) -> None:
    command = (
        "accuracy dusty.gltf --backend gl --size 32x18 --quality-setting normal_bits --views 1 --rounds 1"
        " --plot errors.svg"
    )
    test_extensions_of_a_file_that_the_scene_leaves_out_are_listed_once(capsys, here, command)
    assert (here / "errors.svg").read_text(encoding="utf-8").startswith("<?xml")


def test_pairs_and_times_of_lights_are_charted_with_a_line_for_each_test() -> None:
    figure = Figure()
    ways = [("exact", "sphere", False, True), ("planes", "tight", False, True)]
    keys = ("test", "cones", "depth_mask", "pre_filter", "lights", "pairs", "collect_ms", "draw_ms")
    rows = [dict(zip(keys, (*way, n, 10 * n, 2.0 * n, 3.0), strict=True)) for n in (4, 8) for way in ways]
    plot_tests(figure, rows)
    for axes, times in zip(figure.axes, ([40, 80], [8.0, 16.0], [3.0, 3.0]), strict=True):
        assert [line.get_label() for line in axes.lines] == [
            "exact, pre filter",
            "planes, pre filter, tight cones",
        ]
        assert [list(map(list, line.get_data())) for line in axes.lines] == [[[4, 8], times]] * 2


def test_a_plan_lists_it_beside_the_effects_that_a_frame_lacks(
    capsys: pytest.CaptureFixture[str], here: Path
) -> None:
    write_dusty(here / "dusty.gltf")
    main(["plan", "dusty.gltf", "--json"])
    reason = {entry["name"]: entry["reason"] for entry in json.loads(capsys.readouterr().out)["left_out"]}
    what, path = LEFT_OUT.removeprefix("left out: ").split(" (")
    assert reason[what] == f"the file has it, the scene hasn't: {what} ({path}"
    assert reason["haze"] == "the scene has no haze"


def test_a_report_about_a_whole_scene_lists_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert "left_out" not in run_json(capsys, CITY, "--backend", "null")


def test_a_scene_is_converted_and_looks_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_json(capsys, CITY, "new/city.glb", command="convert")["left_out"] == []
    original, converted = (run_json(capsys, scene, "--backend", "null") for scene in (CITY, "new/city.glb"))
    assert {key for key in original if original[key] != converted[key]} <= {"scene", "milliseconds", "image"}


def test_simulations_that_a_gltf_file_cannot_store_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    main(["convert", "hall:columns=2,flags=2", "hall.gltf"])
    output = capsys.readouterr()
    assert output.err == "left out: simulations of nodes (simulated[0], 12 times)\n"
    assert output.out.startswith("hall.gltf: ")


def test_a_camera_may_begin_with_a_minus(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_json(capsys, CITY, "--backend", "null", "--camera", "-90,40,-90")["draws"] > 0


@pytest.mark.parametrize(
    "command",
    [[], ["render"], ["demo"], ["compare", "visibility"], ["tune"], ["debug", "visibility"], ["scenes"]],
    ids=lambda c: " ".join(c) or "all",
)
def test_help_shows_examples(capsys: pytest.CaptureFixture[str], command: list[str]) -> None:
    with pytest.raises(SystemExit) as exit:
        main([*command, "--help"])
    assert exit.value.code == 0
    assert "python -m renderer " in capsys.readouterr().out


def test_scenes_lists_every_generator_with_its_options(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scenes"]) == 0
    listed = capsys.readouterr().out
    for text in ("city:", "hall:", "grid:", "blocks=44", "seed=0"):
        assert text in listed


def test_demo_without_a_drawing_device_prints_the_null_rows(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, here: Path
) -> None:
    monkeypatch.setenv("RHI_BACKEND", "null")
    assert main(["demo", CITY, "--frames", "2", "--size", "32x18"]) == 0
    output = capsys.readouterr()
    rows = [line.split()[:3] for line in output.out.splitlines()[2:]]
    assert rows == [[path, way, "null"] for path in ("ground", "sky") for way in ("none", "frustum")]
    assert "no image" in output.err
    assert not list(here.iterdir())


def run_demo(capsys: pytest.CaptureFixture[str]) -> tuple[list[list[str]], str]:
    """Return the path, the way and the backend of each row that `demo` prints, and what it says besides."""
    assert main(["demo", CITY, "--frames", "1", "--size", "64x36", "--output", "images"]) == 0
    output = capsys.readouterr()
    return [line.split()[:3] for line in output.out.splitlines()[2:]], output.err


@pytest.mark.usefixtures("gl")
def test_demo_takes_the_backend_that_the_environment_names(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RHI_BACKEND", "gl")
    rows, stderr = run_demo(capsys)
    assert {backend for *_, backend in rows} - {"wgpu"} == {"gl", "null"}
    assert stderr.count("drawn by gl") == 2


@pytest.mark.usefixtures("gl")
def test_demo_omits_devices_that_do_not_work_and_states_the_reason(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    create = rhi.create_device

    def fail_on_cl(name: str | None = None, **options: Any) -> rhi.Device:
        if name == "cl":
            raise rhi.DeviceError(rhi.RULES["device-driver"], "rhi.create_device('cl')", "no OpenCL device")
        return create(name, **options)

    monkeypatch.setattr(rhi, "create_device", fail_on_cl)
    rows, stderr = run_demo(capsys)
    assert "cl is left out: no OpenCL device" in stderr
    assert {backend for *_, backend in rows} - {"wgpu"} == {"gl", "null"}


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
@pytest.mark.usefixtures("gl")
def test_demo_compares_all_backends_that_work_and_renders_each_path(
    capsys: pytest.CaptureFixture[str], here: Path
) -> None:
    assert run_demo(capsys)[0] == [
        [path, way, backend]
        for path in ("ground", "sky")
        for backend in [report.name for report in rhi.report() if report.usable]
        for way in ("none", "frustum")
    ]
    for name in ("city.png", "city-sky.png"):
        assert np.asarray(Image.open(here / "images" / name)).std() > 5


def test_python_m_renderer_is_the_command_line() -> None:
    command = [sys.executable, "-m", "renderer", "render", "ctiy"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, encoding="utf-8")
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1


def test_a_missing_driver_is_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(name: str | None = None, **options: object) -> None:
        raise rhi.DeviceError(
            rhi.RULES["device-driver"], "rhi.create_device()", "no EGL", "", "install libegl1"
        )

    monkeypatch.setattr(rhi, "create_device", fail)
    with pytest.raises(SystemExit) as exit:
        main(["render", CITY])
    error = capsys.readouterr().err
    assert exit.value.code == 2
    assert error.count("\n") == 1
    assert "install libegl1" in error


def test_overlay_and_particles_are_drawn_over_the_image_and_change_no_counter(
    capsys: pytest.CaptureFixture[str],
) -> None:
    command = (
        "hall:columns=6,rows=2,flags=0,fountains=4 --size 640x360 --frame 60 --technique forward --backend gl"
    )
    images, reports = [], []
    for layers in ([], ["--particles"], ["--particles", "--overlay"]):
        report = run_json(capsys, *command.split(), "--visibility", "frustum", *layers)
        del report["hardware_state_changes"]  # a layer leaves other states than it has found
        images.append(np.asarray(Image.open(report["image"])).astype(int))
        reports.append({key: value for key, value in report.items() if key != "milliseconds"})
    assert reports[0] == reports[1] == reports[2]
    plain, sprays, overlaid = images
    assert (plain != sprays).any()
    assert (plain != sprays).mean() < 0.1
    assert (sprays != overlaid)[8:300, 8:300].mean() > 0.5
    assert (sprays == overlaid)[:, 320:330].all()


def test_the_overlay_also_runs_where_nothing_is_drawn(capsys: pytest.CaptureFixture[str]) -> None:
    report = run_json(capsys, CITY, "--backend", "null", "--overlay", "--frames", "3")
    assert report["image"] is None


@pytest.mark.parametrize("module", ["PIL", "tqdm"])
def test_a_missing_package_is_one_line_that_says_what_to_install_by_name_and_from_a_checkout(
    module: str,
) -> None:
    program = (
        f"import sys; sys.modules['{module}'] = None; sys.argv = ['renderer', 'render', 'city', "
        "'--overlay']; "
        "import runpy; runpy.run_module('renderer', run_name='__main__')"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False, encoding="utf-8"
    )
    assert done.returncode == 2
    by_name, in_a_checkout = "pip install 'rhi[renderer]'", "pip install --editable '.[renderer]'"
    assert (
        done.stderr
        == f"error: {module} is missing; install it with: {by_name}, or in a checkout: {in_a_checkout}\n"
    )


@pytest.mark.parametrize(("command", "is_view"), [("view", True), ("scenes", False)])
def test_only_the_viewer_falls_back(command: str, is_view: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    install = Mock()
    monkeypatch.setattr(rhi, "install_fallback", install)
    monkeypatch.setattr(sys, "argv", ["renderer", command, "--help"])
    with pytest.raises(SystemExit):
        run()
    assert install.called is is_view


def test_ray_trace_writes_an_image_in_which_objects_mirror_each_other_by_bounces(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    images = []
    for bounces in ("0", "1"):
        path = tmp_path / f"{bounces}.png"
        report = run_json(
            capsys,
            "grid:mesh=sphere,count=4",
            *("--size", "32x18", "--rays", "1", "--bounces", bounces, "--output", str(path)),
            command="ray-trace",
        )
        assert report["rays"] == 32 * 18
        images.append(np.asarray(Image.open(path)).astype(int))
    differs = (np.abs(images[0] - images[1]).max(axis=2) > 4).sum()
    assert images[0].shape == (18, 32, 3)
    assert 0 < differs < 32 * 18 // 2  # the background is the same


def test_plan_states_the_reason_of_each_pass_and_of_omitted_passes(
    capsys: pytest.CaptureFixture[str],
) -> None:
    report = run_json(capsys, "grid:mesh=box,count=9", "--size", "64x36", command="plan")
    assert [entry["name"] for entry in report["passes"]] == ["forward"]
    assert report["passes"][0]["reason"]
    assert "spot lights" in [entry["name"] for entry in report["left_out"]]
    assert main(["plan", "grid:mesh=box,count=9"]) == 0
    stdout = capsys.readouterr().out
    assert "left out:\n  spot lights: the scene has no spot light" in stdout
    assert stdout.startswith("technique: forward, a null device draws nothing that could be measured\n")


@pytest.mark.parametrize(
    ("technique", "way", "more"),
    [
        ("clustered", "--depth-first", ["depth"]),
        ("deferred_plus", "--multi-pass", ["material ids", "rectangles"]),
        ("deferred_plus", "--binned", ["bins", "resolve"]),
        ("deferred_plus", "--tiled", []),
        ("forward", "--multi-pass", []),
    ],
)
def test_techniques_draw_in_other_ways_on_demand(
    technique: str, way: str, more: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def list_passes(*arguments: str) -> set[str]:
        report = run_json(
            capsys, "grid:mesh=box,count=9,lights=4", "--backend", "null", *arguments, command="plan"
        )
        return {entry["name"] for entry in report["passes"]}

    usual = list_passes("--technique", technique)
    assert list_passes("--technique", technique, way) - usual == set(more)
    name = way.removeprefix("--").replace("-", "_")
    (tmp_path / "s.json").write_text(
        f'{{"rendering": {{"technique": {{"name": "{technique}", "{name}": true}}}}}}', encoding="utf-8"
    )
    render = ["render", "grid:mesh=box,count=9,lights=4", "--backend", "null", "--frames", "1"]
    assert main([*render, "--settings", str(tmp_path / "s.json")]) == 0


@pytest.mark.parametrize(
    ("arguments", "technique", "reason"),
    [
        ([], "forward", "a null device draws nothing that could be measured"),
        (["--technique", "deferred"], "deferred", "was asked for"),
        (["--technique", "forward"], "forward", "was asked for"),
        (["--samples", "4"], "forward", "4 samples per pixel, which other candidates don't have"),
        (["--fxaa"], "forward", "a null device draws nothing that could be measured"),
    ],
)
def test_the_technique_in_use_is_named_with_its_reason(
    capsys: pytest.CaptureFixture[str], arguments: list[str], technique: str, reason: str
) -> None:
    for command in ("plan", "render"):
        size = ["--size", "64x36", "--backend", "null"]
        report = run_json(capsys, "grid:mesh=box,count=9", *size, *arguments, command=command)
        assert (report["technique"], report["reason"]) == (technique, reason)


def test_showing_a_buffer_is_no_choice_of_a_technique(capsys: pytest.CaptureFixture[str]) -> None:
    report = run_json(capsys, CITY, "--backend", "null", "--show", "normals")
    assert (report["technique"], report["reason"]) == ("normals", "is shown")


@pytest.mark.usefixtures("gl")
def test_a_device_chooses_the_technique_of_a_plan(capsys: pytest.CaptureFixture[str]) -> None:
    report = run_json(capsys, "grid:mesh=box,count=9", "--size", "64x36", "--backend", "gl", command="plan")
    assert report["reason"].startswith("the fastest in this view, ")
    first = {"forward": "forward", "clustered_deferred": "geometry"}[report["technique"]]
    assert report["passes"][0]["name"] == first


@pytest.mark.parametrize(
    ("name", "code"), [("plan.svg", 0), ("plan.png", 0), ("plan.jpg", 0), ("plan.txt", 2)]
)
def test_a_plan_is_plotted_to_a_file_that_is_a_chart(
    capsys: pytest.CaptureFixture[str], here: Path, name: str, code: int
) -> None:
    arguments = ["plan", "grid:mesh=box,count=9", "--plot", name]
    if code:
        with pytest.raises(SystemExit) as stopped:
            main(arguments)
        assert stopped.value.code == code
        assert "'plan.txt' is not the name of a chart" in capsys.readouterr().err
    else:
        assert main(arguments) == 0
    assert (here / name).exists() == (not code)
