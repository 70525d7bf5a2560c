"""The tests that are responsible for a module, and those that run for the differences from another commit."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from responsible_tests import ROOT, choose_changed_tests, choose_tests, list_changed_files


@pytest.mark.parametrize(
    ("file", "first", "last"),
    [
        (
            "rhi/backends/cl/raster/boxes.py",
            ("tests/rhi/backends/cl/raster/test_cl_boxes.py", "tests/rhi/backends/cl/raster"),
            ("--pyargs", "rhi.conformance", "--rhi-backend", "cl"),
        ),
        (
            "rhi/backends/null/simulation/hazards.py",
            ("tests/rhi/backends/null/test_null_hazards.py", "tests/rhi/backends/null"),
            ("--pyargs", "rhi.conformance", "--rhi-backend", "null"),
        ),
        (
            "rhi/trace/diff.py",
            ("tests/rhi/trace/test_trace_diff.py", "tests/rhi/trace"),
            ("--pyargs", "rhi.conformance", "--rhi-backend", "gl"),
        ),
    ],
)
def test_a_module_s_tests_are_its_folder_s_and_then_the_kit_s(
    file: str, first: tuple[str, ...], last: tuple[str, ...]
) -> None:
    stages = choose_tests(ROOT, file)
    assert stages[0] == first
    assert stages[-1] == last


def test_a_part_of_the_renderer_is_also_tested_where_it_is_used() -> None:
    direct, users, exam, importers = choose_tests(ROOT, "renderer/scene/meshes.py")
    assert direct == ("tests/renderer/scene",)
    assert 1 < len(users) <= 8
    assert all("renderer.scene" in (ROOT / file).read_text(encoding="utf-8") for file in users)
    assert exam == ("tests/renderer/lab/exam/test_cases.py",)
    assert importers == ("tests/renderer/content",)


@pytest.mark.parametrize("module", ["lighting", "structs", "pixels"])
def test_shaders_are_also_tested_by_the_techniques_that_use_them(module: str) -> None:
    assert ("tests/renderer/techniques",) in choose_tests(ROOT, f"renderer/shaders/{module}.py")


def test_a_module_that_only_its_package_imports_has_no_tests_of_importers() -> None:
    assert choose_tests(ROOT, "renderer/techniques/parts/fxaa.py")[-1] == (
        "tests/renderer/lab/exam/test_cases.py",
    )


# -- what differs from another commit ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("file", "responsible"),
    [
        ("rhi/trace/diff.py", "tests/rhi/trace/test_trace_diff.py"),
        ("rhi/backends/cl/raster/kernels/raster.cl", "tests/rhi/backends/cl/raster"),
        ("renderer/lights/hulls.py", "tests/renderer/lights/test_hulls.py"),
        ("tests/rhi/trace/test_trace_diff.py", "tests/rhi/trace/test_trace_diff.py"),
        ("docs/states.md", "tests/test_docs.py"),
        ("examples/programs/julia.py", "tests/examples"),
        ("tests/renderer/frames.py", "tests/renderer/test_editing.py"),
        ("renderer/shadows/receiver.py", "tests/renderer/shadows"),
        ("rhi/device/device.py", "tests/rhi/device"),
        ("renderer/lab/accuracy/image_errors.py", "tests/renderer/lab/accuracy/test_sweep.py"),
        ("rhi/shading/wgsl/wgsl_writer.py", "rhi/conformance/operation/test_language.py"),
        ("tests/shader_texts.txt", "tests/test_shader_texts.py"),
        ("tests/meta/exam_mutations.toml", "tests/meta/test_exam_detects_mutations.py"),
        ("renderer/lab/exam/cases.toml", "tests/renderer/lab/exam/test_examine.py"),
    ],
)
def test_a_changed_file_runs_the_tests_that_are_responsible_for_it(file: str, responsible: str) -> None:
    assert (ROOT / file).is_file()
    assert responsible in choose_changed_tests(ROOT, [file])


def test_a_changed_module_does_not_run_the_tests_of_unrelated_packages() -> None:
    assert not any("renderer" in test for test in choose_changed_tests(ROOT, ["rhi/trace/diff.py"]))


@pytest.mark.parametrize("file", ["renderer/rules.py", "renderer/renderer.py", "renderer/settings.py"])
def test_a_module_above_many_tests_runs_the_files_that_use_it_only(file: str) -> None:
    tests = choose_changed_tests(ROOT, [file])
    assert "tests/renderer" not in tests
    assert 3 <= len(tests) <= 24


@pytest.mark.parametrize(("language", "device"), [("glsl", "gl"), ("opencl", "cl"), ("wgsl", "wgpu")])
def test_a_writer_of_a_language_runs_the_kit_s_tests_of_the_language_on_its_device(
    language: str, device: str
) -> None:
    arguments = choose_changed_tests(ROOT, [f"rhi/shading/{language}/{language}_writer.py"])
    assert arguments[-3:] == ["rhi/conformance/operation/test_language.py", "--rhi-backend", device]


def test_a_changed_backend_runs_the_kit_on_that_backend_only() -> None:
    arguments = choose_changed_tests(ROOT, ["rhi/backends/gl/gl_draws.py"])
    assert arguments[-4:] == ["--pyargs", "rhi.conformance", "--rhi-backend", "gl"]
    assert "rhi.conformance" not in choose_changed_tests(ROOT, ["rhi/trace/diff.py"])


def test_nothing_changed_runs_the_tests_of_the_structure_only() -> None:
    assert all(test.startswith("tests/test_") for test in choose_changed_tests(ROOT, []))


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """A repository with one commit on `main`, and one on a branch that left it there."""

    def run_git(*arguments: str) -> None:
        identity = ["-c", "user.name=tester", "-c", "user.email=tester@example.com"]
        subprocess.run(["git", *identity, *arguments], cwd=tmp_path, check=True, capture_output=True)

    run_git("init", "-q", "-b", "main")
    for name in ("kept.py", "edited.py", "deleted.py"):
        (tmp_path / name).write_text("", encoding="utf-8")
    run_git("add", ".")
    run_git("commit", "-q", "-m", "first")
    run_git("switch", "-q", "-c", "branch")
    (tmp_path / "committed.py").write_text("", encoding="utf-8")
    run_git("add", ".")
    run_git("commit", "-q", "-m", "second")
    return tmp_path


def test_a_branch_differs_from_main_by_its_commits_and_its_uncommitted_changes(repository: Path) -> None:
    (repository / "edited.py").write_text("1", encoding="utf-8")
    (repository / "new.py").write_text("", encoding="utf-8")
    (repository / "deleted.py").unlink()
    assert list_changed_files(repository) == ["committed.py", "edited.py", "new.py"]


def test_main_differs_from_its_last_commit_by_uncommitted_changes(repository: Path) -> None:
    subprocess.run(["git", "switch", "-q", "-f", "main"], cwd=repository, check=True)
    assert list_changed_files(repository) == []
    (repository / "edited.py").write_text("1", encoding="utf-8")
    assert list_changed_files(repository) == ["edited.py"]


def test_a_base_can_be_named(repository: Path) -> None:
    assert list_changed_files(repository, "HEAD") == []
