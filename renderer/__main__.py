"""Entry point of `python -m renderer`."""

import sys

from rhi.errors.readers import run_for_reader

try:
    from renderer.cli import main
except ModuleNotFoundError as missing:
    if missing.name not in ("PIL", "tqdm"):
        raise
    print(f"error: {missing.name} is missing; install it with: pip install 'rhi[renderer]'", file=sys.stderr)
    sys.exit(2)

if __name__ == "__main__":
    sys.exit(run_for_reader(main))
