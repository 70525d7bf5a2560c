"""The cost of text: glyphs laid out, recorded and drawn in a millisecond, on the null device and on those
that draw.

A text is laid out (`lay out`), or laid out and added to a canvas (`text`), or a frame of it is uploaded,
drawn and waited for (`draw`). The variants take turns, round by round, in one process. Figures are medians
over the rounds of the processor's time, of all threads: that of a device on the CPU is part of it.

    python benchmarks/text.py [--json] [--backends null,gl,cl] [--rounds 41]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from functools import partial
from typing import Final

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.lab.comparison import Record, Subject, compare, rate
from renderer.layers.canvas import Canvas, Font, lay_out, srgb

WHITE: Final = srgb("#ffffff")
LINE: Final = "The quick brown fox jumps over 13 lazy dogs; AVATAR To. Wörter mit Öl,\t1,204 bytes\t12.5 ms\n"
TEXTS: Final = {"line": LINE.rstrip(), "page": LINE * 40}


OPTIONS: Final = (
    options.option("--backends", "backends to measure", None, "all that work here"),
    options.rounds("rounds", 41),
)


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the glyphs in a millisecond of each step and text on each device."""
    usable = [each.name for each in rhi.report() if each.usable]
    for backend in arguments.backends.split(",") if arguments.backends else usable:
        with rhi.create_device(backend) as device:
            yield from measure_device(device, arguments.rounds)


def measure_device(device: rhi.Device, rounds: int) -> Iterator[Record]:
    canvas = Canvas(device, Font.load())
    image = device.texture((960, 720), rhi.Format.RGBA8_SRGB)

    def lay(text: str, _: int) -> None:
        lay_out(canvas.font, text)

    def add(text: str, _: int) -> None:
        canvas.text(8, 8, text, WHITE)
        canvas.forget()

    def draw(text: str, _: int) -> None:
        canvas.text(8, 8, text, WHITE)
        with device.render_pass(image):
            canvas.draw(image.size)
        device.present(image)
        device.finish()

    subjects = []
    for step, run in {"lay out": lay, "text": add, "draw": draw}.items():
        for name, text in TEXTS.items():
            glyphs = len(lay_out(canvas.font, text).glyphs)
            labels = {"backend": device.backend_name, "step": step, "text": name, "glyphs": glyphs}
            subjects.append(Subject(labels, partial(run, text), device=device))
    for row in compare(subjects, {"glyphs/ms": rate(1e-3, processor=True)}, range(rounds), warm_ups=30):
        yield row | {"glyphs/ms": row["glyphs"] * row["glyphs/ms"]}


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
