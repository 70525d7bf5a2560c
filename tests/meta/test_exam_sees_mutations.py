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
    tried = {number for one in exam_mutations.MUTATIONS for number in one.cases}
    assert tried == CASES.keys()


def test_what_a_mutation_replaces_is_there_once() -> None:
    """Found here and not by night: a mutation whose text has moved tries nothing."""
    for one in exam_mutations.MUTATIONS:
        found = importlib.util.find_spec(one.module)
        assert found is not None
        assert found.origin is not None
        assert Path(found.origin).read_text().count(one.old) == 1, (one.module, one.old)


@pytest.mark.nightly
def test_each_mutation_is_seen_by_its_case() -> None:
    """In processes of their own: this one has imported what they break."""
    run = subprocess.run([sys.executable, exam_mutations.__file__], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    results = [json.loads(line) for line in run.stdout.splitlines()]
    assert len(results) == sum(len(one.cases) for one in exam_mutations.MUTATIONS)
    assert [result for result in results if not result["seen"]] == []
