"""Entry point of `python -m renderer`."""

import sys

try:
    from renderer.cli import main
except ModuleNotFoundError as missing:
    if missing.name not in ("PIL", "tqdm"):
        raise
    print(f"error: {missing.name} is missing; install it with: pip install 'rhi[renderer]'", file=sys.stderr)
    sys.exit(2)

if __name__ == "__main__":
    sys.exit(main())
