"""Entry point of `python -m renderer`, and of the command `rhi-renderer`."""

import sys

import rhi


def run() -> int:
    """Run the command that the process was given, and return its exit status."""
    if not hasattr(rhi, "__path__"):  # so nothing of the package can be imported
        print(
            f"error: {rhi.__file__} hides the package rhi: rhi-renderer, or python -P -m renderer",
            file=sys.stderr,
        )
        return 2
    from rhi.errors.pipes import open_standard_streams, run_until_pipe_closes

    open_standard_streams()
    if sys.argv[1:2] == ["view"]:  # before the renderer's shaders are imported
        rhi.install_fallback()
    from renderer.cli import main

    return run_until_pipe_closes(main)


if __name__ == "__main__":
    sys.exit(run())
