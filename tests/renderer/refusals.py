"""Refusals: which rule a call breaks, and what a viewer says of a line."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from rhi import ValidationError


def refused_rule(call: Callable[[], object]) -> str:
    """Return the id of the rule that a call breaks, which has to be refused."""
    with pytest.raises(ValidationError) as refused:
        call()
    return refused.value.rule.id


def refused_message(run: Callable[[str], tuple[str, bool]], line: str) -> str:
    """The refusal of a line, which has to be refused; `run` is that of a viewer."""
    message, is_error = run(line)
    assert is_error, message
    return message
