"""The command line of a program that draws one image.

def render(device, size): ...

if __name__ == "__main__":
    save_image(render)
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import rhi


def save_image(
    render: Callable[[rhi.Device, tuple[int, int]], rhi.Texture], arguments: Sequence[str] | None = None
) -> None:
    """Draw an image as the command line says, and save it; the main module's docstring is the help text.

    Args:
        render: returns the texture that it has drawn, for a device and a size (width, height).
        arguments: `--backend NAME`, `--size WxH` and `--output FILE`; None: those of the program.
    """
    parser = argparse.ArgumentParser(description=sys.modules["__main__"].__doc__)
    parser.add_argument(
        "--backend", help="gl, cl or the name of another backend (default: the first that draws)"
    )
    parser.add_argument("--size", default="640x480", metavar="WxH", help="pixels (default: 640x480)")
    parser.add_argument(
        "--output", type=Path, default=Path(f"{Path(sys.argv[0]).stem}.png"), help="default: %(default)s"
    )
    options = parser.parse_args(arguments)
    width, _, height = options.size.partition("x")
    with rhi.create_device(options.backend) as device:
        render(device, (int(width), int(height))).save(options.output)
    print(options.output)
