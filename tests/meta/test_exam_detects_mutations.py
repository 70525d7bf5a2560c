"""The exam can fail: for each case there is a fault of the renderer that it sees."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import exam_mutations
import pytest

from renderer.lab.exam import CASES


def test_every_case_has_a_mutation() -> None:
    tried = {number for mutation in exam_mutations.MUTATIONS for number in mutation.cases}
    assert tried == CASES.keys()


def test_the_text_that_a_mutation_replaces_occurs_once() -> None:
    """Found in the default run, not in the nightly one: a mutation whose text has moved tries nothing."""
    for mutation in exam_mutations.MUTATIONS:
        spec = importlib.util.find_spec(mutation.module)
        assert spec is not None
        assert spec.origin is not None
        assert Path(spec.origin).read_text(encoding="utf-8").count(mutation.old) == 1, (
            mutation.module,
            mutation.old,
        )


@pytest.mark.nightly
def test_each_mutation_is_detected_by_its_case() -> None:
    """In processes of their own: this one has imported what they break."""
    run = subprocess.run(
        [sys.executable, exam_mutations.__file__],
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )
    assert run.returncode == 0, run.stderr
    results = [json.loads(line) for line in run.stdout.splitlines()]
    assert len(results) == sum(len(mutation.cases) for mutation in exam_mutations.MUTATIONS)
    assert [result for result in results if not result["seen"]] == []
