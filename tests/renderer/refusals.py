"""Refusals: which rule a call breaks."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from rhi import ValidationError


def find_rule(call: Callable[[], object]) -> str:
    """Return the id of the rule that a call breaks, which has to be refused."""
    with pytest.raises(ValidationError) as refused:
        call()
    return refused.value.rule.id
