"""The reports that commands print with `--json`."""

from __future__ import annotations

import io
import json
from contextlib import redirect_stdout
from typing import Any

from renderer.cli import main


def read_report(*arguments: str) -> Any:
    """Run a command, which prints its report as JSON; return the report."""
    printed = io.StringIO()
    with redirect_stdout(printed):
        assert main([*arguments]) == 0
    return json.loads(printed.getvalue())
