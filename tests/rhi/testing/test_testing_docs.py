"""docs/testing.md runs as a test file, on the null device and, where it works, on GL."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from testing_kit import gl_works

PAGE = Path(__file__).parents[3] / "docs" / "testing.md"

pytest_plugins = ["pytester"]


@pytest.fixture
def tests(pytester: pytest.Pytester) -> int:
    """Write the page's file and return the number of its tests."""
    source = "\n\n".join(re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL))
    pytester.path.joinpath("test_shadow.py").write_text(source)
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
    source = file.read_text()
    assert source.count(old) >= 1
    file.write_text(source.replace(old, new, 1))
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
def test_the_page_shows_what_a_failure_says(
    pytester: pytest.Pytester, tests: int, block: int, old: str, new: str
) -> None:
    message = re.findall(r"```text\n(.*?)```", PAGE.read_text(), re.DOTALL)[block].replace(
        "renderer.py", "*.py"
    )
    file = pytester.path / "test_shadow.py"
    file.write_text(file.read_text().replace(old, new, 1))
    run = pytester.runpytest("-p", "no:cacheprovider")
    run.stdout.fnmatch_lines([f"*{line.replace('…', '*')}*" for line in message.splitlines() if line != "…"])
