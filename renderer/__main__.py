"""Entry point of `python -m renderer`."""

import sys

from renderer.rules import describe_missing
from rhi.errors.readers import run_for_reader

try:
    from renderer.cli import main
except ModuleNotFoundError as missing:
    if missing.name not in ("PIL", "tqdm"):
        raise
    print(f"error: {describe_missing(missing.name, 'renderer')}", file=sys.stderr)
    sys.exit(2)

if __name__ == "__main__":
    sys.exit(run_for_reader(main))
