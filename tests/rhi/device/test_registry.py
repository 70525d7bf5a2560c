"""Choosing a backend, and the error if there is none."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from nightly_reasons import CHEAPER_TEST

import rhi
from rhi import Capabilities
from rhi.__main__ import main
from rhi.device.registry import BackendReport


def test_the_null_device_is_never_chosen_by_itself() -> None:
    assert rhi.backend_names()[-1] == "null"


def test_an_unknown_name_is_refused_with_a_suggestion() -> None:
    with pytest.raises(rhi.DeviceError, match="did you mean 'null'") as caught:
        rhi.create_device("nul")
    assert caught.value.rule.id == "device-unknown"


@pytest.mark.parametrize("name", ["os:system", "os:path", "math:pi", "rhi:load_backend_factory"])
def test_a_name_that_is_not_a_backend_factory_is_refused_without_being_called(name: str) -> None:
    with pytest.raises(rhi.DeviceError, match="device-unknown") as caught:
        rhi.create_device(name)
    assert repr(name) in caught.value.given


def test_the_environment_names_the_backend(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RHI_BACKEND", "null")
    with rhi.create_device() as device:
        assert device.backend_name == "null"


def test_an_argument_wins_over_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RHI_BACKEND", "nothing-of-the-kind")
    with rhi.create_device("null") as device:
        assert device.backend_name == "null"


def test_the_null_device_records_by_default() -> None:
    with rhi.create_device("null") as device:
        assert len(device.stream) == 0
    with rhi.create_device("null", record=False) as device, pytest.raises(rhi.ValidationError) as caught:
        _ = device.stream
    assert caught.value.rule.id == "device-not-recording"


def test_options_are_the_backends_own() -> None:
    with rhi.create_device("null", profile="gles-3") as device:
        assert device.capabilities.device == "gles-3"
    with pytest.raises(rhi.ValidationError, match=r"^\[device-argument\]") as caught:
        rhi.create_device("null", profil="gles-3")
    assert "profil=" in caught.value.call
    assert caught.value.allowed == "faults, profile, simulation"


def test_a_backend_without_options_refuses_them() -> None:
    with pytest.raises(rhi.ValidationError) as caught:
        rhi.create_device("cl", profile="gles-3")
    assert caught.value.allowed == "no options"


def test_options_without_a_name_go_to_the_backends_that_are_tried() -> None:
    with pytest.raises(rhi.DeviceError) as caught:
        rhi.create_device(profile="gles-3")
    assert "gl: profile" in caught.value.given


def test_the_report_names_every_backend(capsys: pytest.CaptureFixture[str]) -> None:
    main([])
    text = capsys.readouterr().out
    assert all(name in text for name in rhi.backend_names())


def report_of(name: str, device: str | None = None) -> BackendReport:
    limits = Capabilities(name, device, "a driver") if device is not None else None
    return BackendReport(name, limits is not None, "" if limits else "one reason\nanother", "a tip", limits)


@pytest.mark.parametrize(
    ("named", "reports", "says"),
    [
        ("", [report_of("gl", "a GPU"), report_of("cl", "a CPU")], "gl"),
        ("", [report_of("gl"), report_of("cl", "a CPU")], "cl"),
        ("", [report_of("gl")], "nothing; see the reasons above"),
        ("cl", [report_of("gl", "a GPU"), report_of("cl", "a CPU")], "cl, as RHI_BACKEND says"),
        (
            "cl",
            [report_of("gl", "a GPU"), report_of("cl")],
            "nothing: RHI_BACKEND names cl, which can't be used",
        ),
        ("", [report_of("gl", "llvmpipe"), report_of("cl")], "gl"),
        (
            "",
            [report_of("gl", "llvmpipe"), report_of("cl", "a CPU")],
            "gl\nllvmpipe draws on the CPU; RHI_BACKEND=cl is faster, but for long shaders",
        ),
    ],
)
def test_the_report_names_the_backend_that_would_be_chosen(
    named: str,
    reports: list[BackendReport],
    says: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("RHI_BACKEND", named)
    monkeypatch.setattr(rhi, "report", lambda: reports)
    main([])
    assert capsys.readouterr().out.endswith(f"would choose: {says}\n")


def test_a_reason_of_several_lines_is_indented(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(rhi, "report", lambda: [report_of("gl")])
    main([])
    assert "gl     not usable: one reason\n           another\n       a tip\n" in capsys.readouterr().out


def test_the_report_as_json_has_capabilities(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--json"])
    report = json.loads(capsys.readouterr().out)
    null = next(b for b in report["backends"] if b["name"] == "null")
    assert null["usable"]
    assert null["capabilities"]["shading"] is False
    assert all(
        b["capabilities"]["platform_states"] == {"gl": ["DepthClamp"]}.get(b["name"], [])
        for b in report["backends"]
        if b["usable"]
    )


def imported(code: str) -> set[str]:
    """Run code in a new process; return the modules that it imported."""
    script = f"import sys\n{code}\nprint('\\n'.join(sys.modules))"
    run = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, encoding="utf-8"
    )
    return set(run.stdout.split())


@pytest.mark.parametrize(
    "code", ["import rhi", "import rhi.shading", "import rhi\nrhi.create_device('null').close()"]
)
def test_importing_the_package_omits_modules_that_a_first_frame_does_not_need(code: str) -> None:
    """Each of these takes part of the first second: languages that no device has asked for, tools, and
    modules of the standard library and NumPy that only errors or rare features need."""
    modules = imported(code) - imported("import numpy")  # NumPy 1.26 imports all of itself
    packages = {
        "rhi.testing.accuracy",
        "rhi.backends.cl",
        "rhi.backends.gl",
        "rhi.conformance",
        "rhi.shading.evaluation",
        "rhi.shading.lowering",
        "rhi.shading.numpy",
        "rhi.shading.opencl",
        "rhi.testing",
        "rhi.trace",
    }
    others = {
        "asyncio",
        "difflib",
        "glcontext",
        "hashlib",
        "moderngl",
        "multiprocessing",
        "numpy.fft",
        "numpy.ma",
        "numpy.polynomial",
        "numpy.random",
        "numpy.testing",
        "pyopencl",
        "rhi.shading.glsl.spirv",
        "rhi.shading.glsl.vulkan",
        "sqlite3",
        "subprocess",
        "unittest",
    }
    assert "rhi.device.device" in modules or "rhi.shading.compile" in modules
    assert modules & (packages | others) == set()


@pytest.mark.nightly_cases("gl", reason=CHEAPER_TEST)
@pytest.mark.parametrize("name", ["gl", "cl"])
def test_a_first_frame_imports_only_its_own_backend_and_language(name: str) -> None:
    draws = """
import rhi
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle
with rhi.create_device(NAME) as device:
    image = device.texture((16, 16), rhi.Format.RGBA8)
    with device.render_pass(image, clear=(0, 0, 0, 1)):
        device.draw(device.program(Colored), device.mesh(rectangle()))
    assert image.read().any()
"""
    modules = imported(draws.replace("NAME", repr(name)))
    other = {"gl": "cl", "cl": "gl"}[name]
    assert f"rhi.backends.{name}" in modules
    assert f"rhi.backends.{other}" not in modules
    assert "rhi.shading.numpy" not in modules
    assert ("rhi.shading.lowering" in modules) == (name == "cl")
    assert {"pyopencl.array", "mako", "rhi.backends.cl.pocl.compiler"} & modules == set()


@pytest.mark.nightly_cases("gl-pyopencl-moderngl", reason=CHEAPER_TEST)
@pytest.mark.parametrize(
    ("name", "other", "package"), [("gl", "pyopencl", "moderngl"), ("cl", "moderngl", "pyopencl")]
)
def test_a_device_needs_and_imports_the_package_of_its_own_driver(
    name: str, other: str, package: str
) -> None:
    """As after `pip install --no-deps rhi`: the other backend's package isn't there."""
    if name not in [backend.name for backend in rhi.report() if backend.usable]:
        pytest.skip(f"{name} doesn't work here")
    program = f"""
import sys
sys.modules[{other!r}] = None
import rhi
drivers = {{"moderngl", "pyopencl", "wgpu", "PIL", "watchfiles", "matplotlib", "importlib.metadata"}}
print(sorted(drivers & {{name for name, module in sys.modules.items() if module is not None}}))
rhi.create_device({name!r}).close()
print(sorted(drivers & {{name for name, module in sys.modules.items() if module is not None}}))
print([(each.name, each.usable) for each in rhi.report() if each.name in ("gl", "cl")])
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, encoding="utf-8"
    )
    usable = [("gl", name == "gl"), ("cl", name == "cl")]
    assert done.stdout.splitlines() == ["[]", str(sorted(["importlib.metadata", package])), str(usable)]
