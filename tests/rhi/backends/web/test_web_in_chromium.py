"""The conformance kit in a page of headless Chromium, on SwiftShader: one group by default, all of them in the
nightly run."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from chromium_kit import Page
from kit_page import open_kit, run_kit
from web_kit import ENDLESS, EXPECTED_FAILURES, check_kit, run_in_node

DEFAULT_GROUPS = ("orientation",)
"""A group of operations that takes a second or two, beside the start of Python."""
IN_CHROMIUM = EXPECTED_FAILURES | dict.fromkeys(
    (
        "test_blocks_are_read_as_texels[web-direct-BC",
        "test_blocks_replace_their_texels_only[web-direct]",
        "test_layers_of_blocks_are_written_at_once[web-direct-BC",
        "test_the_faces_of_a_cube_may_be_blocks[web-direct]",
    ),
    "Chromium's SwiftShader reads zeros of compressed textures, also in plain JavaScript",
)


@pytest.fixture
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    if not (run_in_node.FOLDER / "pyodide").is_dir():
        pytest.skip("no Pyodide: python scripts/run_in_node.py --fetch")
    with open_kit(tmp_path_factory.mktemp("kit")) as opened:
        yield opened


def test_the_default_groups_pass_in_chromium(page: Page) -> None:
    run = run_kit(page, *(f"rhi.conformance.operation.test_{group}" for group in DEFAULT_GROUPS))
    assert check_kit(run.output, {}) > 20


@pytest.mark.nightly
def test_the_kit_passes_in_chromium(page: Page) -> None:
    run = run_kit(page, "rhi.conformance", "-k", f"not ({' or '.join(ENDLESS)})")
    assert check_kit(run.output, IN_CHROMIUM) > 3000
