"""Which tests are responsible for a module, and which are run for what differs from another commit."""

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
    own, users, exam, importers = choose_tests(ROOT, "renderer/scene/meshes.py")
    assert own == ("tests/renderer/scene",)
    assert 1 < len(users) <= 8
    assert all("renderer.scene" in (ROOT / file).read_text() for file in users)
    assert exam == ("tests/renderer/lab/exam/test_cases.py",)
    assert importers == ("tests/renderer/content",)


@pytest.mark.parametrize("module", ["lighting", "structs", "pixels"])
def test_shaders_are_also_tested_by_the_techniques_that_are_made_of_them(module: str) -> None:
    assert ("tests/renderer/techniques",) in choose_tests(ROOT, f"renderer/shaders/{module}.py")


def test_what_only_its_package_imports_has_no_tests_of_importers() -> None:
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
    ],
)
def test_a_changed_file_runs_the_tests_that_are_responsible_for_it(file: str, responsible: str) -> None:
    assert (ROOT / file).is_file()
    assert responsible in choose_changed_tests(ROOT, [file])


def test_a_changed_module_does_not_run_the_tests_of_unrelated_packages() -> None:
    assert not any("renderer" in test for test in choose_changed_tests(ROOT, ["rhi/trace/diff.py"]))


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
        (tmp_path / name).write_text("")
    run_git("add", ".")
    run_git("commit", "-q", "-m", "first")
    run_git("switch", "-q", "-c", "branch")
    (tmp_path / "committed.py").write_text("")
    run_git("add", ".")
    run_git("commit", "-q", "-m", "second")
    return tmp_path


def test_a_branch_differs_from_main_by_its_commits_and_by_what_is_not_committed(repository: Path) -> None:
    (repository / "edited.py").write_text("1")
    (repository / "new.py").write_text("")
    (repository / "deleted.py").unlink()
    assert list_changed_files(repository) == ["committed.py", "edited.py", "new.py"]


def test_main_differs_from_its_last_commit_by_what_is_not_committed(repository: Path) -> None:
    subprocess.run(["git", "switch", "-q", "-f", "main"], cwd=repository, check=True)
    assert list_changed_files(repository) == []
    (repository / "edited.py").write_text("1")
    assert list_changed_files(repository) == ["edited.py"]


def test_a_base_can_be_named(repository: Path) -> None:
    assert list_changed_files(repository, "HEAD") == []
