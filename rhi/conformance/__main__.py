"""`python -m rhi.conformance`: runs the kit; its arguments are pytest's, such as `--rhi-backend gl -k depth`."""

from __future__ import annotations

import sys


def main(arguments: list[str] | None = None) -> int:
    """Run the kit by pytest, and return its exit code; 2 without pytest, with a line that says so."""
    try:
        import pytest
    except ImportError:
        line = "error: pytest is missing; install it with: pip install pytest"
        print(line, file=sys.stderr)
        return 2
    given = sys.argv[1:] if arguments is None else arguments
    return int(pytest.main(["--pyargs", "rhi.conformance", *given]))


if __name__ == "__main__":
    sys.exit(main())
