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
    options = sys.argv[1:] if arguments is None else arguments
    # `python -m` has imported rhi, so pytest can't rewrite its assertions; the kit's modules are still to come.
    quiet = ("-W", "ignore::pytest.PytestAssertRewriteWarning")
    return int(pytest.main([*quiet, "--pyargs", "rhi.conformance", *options]))


if __name__ == "__main__":
    sys.exit(main())
