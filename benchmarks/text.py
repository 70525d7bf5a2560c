"""The cost of text: glyphs laid out, recorded and drawn in a millisecond, on the null device and on those that draw.

A text is laid out (`lay out`), or laid out and added to a canvas (`text`), or a frame of it is uploaded, drawn and
waited for (`draw`). The variants take turns, round by round, in one process. Figures are medians over the rounds of
the processor's time, of all threads: that of a device on the CPU is part of it.

    python benchmarks/text.py [--json] [--backends null,gl,cl] [--rounds 41]
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from statistics import median
from typing import Final

import rhi
from renderer.layers.canvas import Canvas, Font, lay_out, srgb

WHITE: Final = srgb("#ffffff")
LINE: Final = "The quick brown fox jumps over 13 lazy dogs; AVATAR To. Wörter mit Öl,\t1,204 bytes\t12.5 ms\n"
TEXTS: Final = {"line": LINE.rstrip(), "page": LINE * 40}


def measure(backend: str, rounds: int) -> dict[str, float]:
    """Return the glyphs in a millisecond of each variant on a device."""
    with rhi.create_device(backend) as device:
        canvas = Canvas(device, Font.load())
        image = device.texture((960, 720), rhi.Format.RGBA8_SRGB)

        def add(text: str) -> None:
            canvas.text(8, 8, text, WHITE)
            canvas.forget()

        def draw(text: str) -> None:
            canvas.text(8, 8, text, WHITE)
            with device.render_pass(image):
                canvas.draw(image.size)
            device.present(image)
            device.finish()

        def lay(text: str) -> None:
            lay_out(canvas.font, text)

        steps: dict[str, Callable[[str], None]] = {"lay out": lay, "text": add, "draw": draw}
        counts = {f"{step}, a {name}": len(lay_out(canvas.font, text).glyphs)
                  for step in steps for name, text in TEXTS.items()}  # fmt: skip

        def run(variant: str) -> None:
            step, _, name = variant.partition(", a ")
            steps[step](TEXTS[name])

        for variant in counts:
            for _ in range(30):  # kernels get hot, rings get their size
                run(variant)
        times: dict[str, list[float]] = {variant: [] for variant in counts}
        for _ in range(rounds):
            for variant, spent in times.items():
                began = time.process_time()
                run(variant)
                spent.append(1e3 * (time.process_time() - began))
            if backend == "null":
                device.stream.clear()
        return {variant: counts[variant] / median(spent) for variant, spent in times.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--backends", default=",".join(rhi.backend_names()), help="default: %(default)s")
    parser.add_argument("--rounds", type=int, default=41, help="rounds (default: %(default)s)")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    arguments = parser.parse_args()
    rates = {name: measure(name, arguments.rounds) for name in arguments.backends.split(",")}
    if arguments.json:
        print(json.dumps(rates, indent=2))
        return
    for name, each in rates.items():
        for variant, rate in each.items():
            print(f"{name:5} {variant:18} {rate:8,.0f} glyphs/ms")


if __name__ == "__main__":
    main()
