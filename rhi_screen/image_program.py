"""The command line of a program that draws one image. In a page (Pyodide) it shows the image on a canvas.

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

    In a page without `--output` the image is shown on a canvas (`open_screen`), in its size, and drawn again
    when that changes.

    Args:
        render: returns the texture that it has drawn, for a device and a size (width, height).
        arguments: `--backend NAME`, `--size WxH` and `--output FILE`; None: those of the program.
    """
    parser = argparse.ArgumentParser(description=sys.modules["__main__"].__doc__)
    parser.add_argument(
        "--backend", help="gl, cl or the name of another backend (default: the first that draws)"
    )
    parser.add_argument("--size", metavar="WxH", help="pixels (default: 640x480)")
    default = Path(f"{Path(sys.argv[0]).stem}.png")
    parser.add_argument("--output", type=Path, help=f"default: {default}")
    options = parser.parse_args(arguments)
    size = tuple(map(int, (options.size or "640x480").split("x")))
    if sys.platform == "emscripten" and options.output is None:
        _show(render, options.backend, size if options.size else None)
        return
    output = options.output or default
    with rhi.create_device(options.backend) as device:
        render(device, (size[0], size[1])).save(output)
    print(output)


def _show(
    render: Callable[[rhi.Device, tuple[int, int]], rhi.Texture],
    backend: str | None,
    size: tuple[int, ...] | None,
) -> None:
    from rhi_screen.screen import open_screen

    screen = open_screen(backend)
    try:
        screen.run(lambda: screen.show(render(screen.device, (size[0], size[1]) if size else screen.size)))
    except BaseException:
        screen.close()
        raise
    if screen.canvas.get_closed():  # else Python couldn't wait, and the page shows the image from now on
        screen.close()
