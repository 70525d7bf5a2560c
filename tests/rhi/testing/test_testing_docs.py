"""docs/testing.md runs as a test file, on the null device and, where it works, on GL."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from testing_kit import backend_works, gl_works

import rhi.testing.portability

PAGE = Path(__file__).parents[3] / "docs" / "testing.md"

pytest_plugins = ["pytester"]
assert rhi.testing.portability  # runs of pytest in this process share its modules


@pytest.fixture
def tests(pytester: pytest.Pytester) -> int:
    """Write the page's file and return the number of its tests."""
    source = "\n\n".join(re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL))
    pytester.path.joinpath("test_shadow.py").write_text(source, encoding="utf-8")
    return len(re.findall(r"^def test_", source, re.MULTILINE))


def test_the_page_passes_on_the_null_device(pytester: pytest.Pytester, tests: int) -> None:
    assert tests >= 8
    pytester.runpytest("-p", "no:cacheprovider").assert_outcomes(passed=tests)


@pytest.mark.skipif(not gl_works(), reason="no GL device here")
def test_the_page_passes_on_a_gpu(pytester: pytest.Pytester, tests: int) -> None:
    run = pytester.runpytest("-p", "no:cacheprovider", "--rhi-backend", "gl", "--rhi-backend", "null")
    run.assert_outcomes(passed=tests + 1)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('device.event("sun")', 'device.event("moon")'),
        ("CullMode.FRONT, DepthBias(-2.0)", "DepthBias(-2.0)"),
        ("DepthBias(-2.0)", "DepthBias(-3.0)"),
        ("camera=self.sun)", "camera=self.eye)"),
        ('Camera(offset=(0, 0, 0, 0)), label="sun"', 'Camera(offset=(0, 0, 0, 5)), label="sun"'),
    ],
)
def test_the_page_notices_a_broken_renderer(
    pytester: pytest.Pytester, tests: int, old: str, new: str
) -> None:
    file = pytester.path / "test_shadow.py"
    source = file.read_text(encoding="utf-8")
    assert source.count(old) >= 1
    file.write_text(source.replace(old, new, 1), encoding="utf-8")
    run = pytester.runpytest("-p", "no:cacheprovider")
    assert run.parseoutcomes()["failed"] >= 1


@pytest.mark.parametrize(
    ("block", "old", "new"),
    [
        (0, 'device.event("sun")', 'device.event("moon")'),
        (
            1,
            "render_without_shadows(renderer, null_device)\n    with_shadows",
            "renderer.render()\n    with_shadows",
        ),
    ],
)
def test_the_page_shows_the_message_of_a_failure(
    pytester: pytest.Pytester, tests: int, block: int, old: str, new: str
) -> None:
    message = re.findall(r"```text\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[block].replace(
        "renderer.py", "*.py"
    )
    file = pytester.path / "test_shadow.py"
    file.write_text(file.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")
    run = pytester.runpytest("-p", "no:cacheprovider")
    run.stdout.fnmatch_lines([f"*{line.replace('…', '*')}*" for line in message.splitlines() if line != "…"])


ENGINE_PAGE = PAGE.with_name("engine-tests.md")


@pytest.fixture
def engine_tests(pytester: pytest.Pytester) -> Path:
    """The file of the page on an engine's tests."""
    source = "\n\n".join(
        re.findall(r"```python\n(.*?)```", ENGINE_PAGE.read_text(encoding="utf-8"), re.DOTALL)
    )
    file = pytester.path / "test_engine.py"
    file.write_text(source, encoding="utf-8")
    return file


@pytest.mark.parametrize("backend", ["null", "gl", "cl", "wgpu"])
def test_an_engines_twelve_assertions_hold_on_each_backend(
    pytester: pytest.Pytester, engine_tests: Path, backend: str
) -> None:
    if not backend_works(backend):
        pytest.skip(f"no device of {backend} here")
    pytester.runpytest("-p", "no:cacheprovider", "--rhi-update-streams", "-k", "test_12").assert_outcomes(
        passed=1, deselected=11
    )
    pytester.runpytest("-p", "no:cacheprovider", "--rhi-backend", backend).assert_outcomes(passed=12)


@pytest.mark.parametrize(
    ("number", "old", "new"),
    [
        (1, 'device.event("boxes")', 'device.event("crates")'),
        (2, 'draws["instances"] = self.boxes // 2,', 'draws["instances"] = self.boxes // 3,'),
        (3, "CullMode.NONE, DepthFunction.GREATER_EQUAL),", "CullMode.NONE, DepthFunction.ALWAYS),"),
        (4, "camera=camera, positions=self.positions)", "camera=camera, positions=device.storage(vec4, 8))"),
        (5, "view_projection=np.eye(4))", "view_projection=2 * np.eye(4))"),
        (6, "        device.present(self.image)\n", ""),
        (
            7,
            "device, camera = self.device,",
            "device.texture((4, 4), Format.RGBA8); device, camera = self.device,",
        ),
        (
            8,
            "program = device.program(Box)\n",
            "program = device.program(Box); device.draw(device.program(FoggyBox), self.box, camera=camera, "
            "positions=self.positions, fog=Fog(color=(1, 1, 1, 1), density=1.0))\n",
        ),
        (9, "program = device.program(Box)\n", "program = device.program(FoggyBox)\n"),
        (
            10,
            "if self.fog is None:",
            "self.old = getattr(self, 'old', None) or self.fog\n            if self.fog is None and self.old is None:",
        ),
        (11, "DepthFunction.GREATER_EQUAL),", "DepthFunction.NEVER),"),
        (12, "clear=(0, 0, 0, 1)", "clear=(0, 0, 0, 0)"),
    ],
)
def test_each_of_the_twelve_notices_a_broken_engine(
    pytester: pytest.Pytester, engine_tests: Path, number: int, old: str, new: str
) -> None:
    options = ("-p", "no:cacheprovider", "-k", f"test_{number}_")
    pytester.runpytest(*options, "--rhi-update-streams").assert_outcomes(passed=1, deselected=11)
    source = engine_tests.read_text(encoding="utf-8")
    assert source.count(old) == 1
    engine_tests.write_text(source.replace(old, new), encoding="utf-8")
    outcome = pytester.runpytest(*options).parseoutcomes()
    assert outcome.get("failed", 0) + outcome.get("errors", 0) == 1
