"""Costs of the same passes of a scene on each backend."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from typing import Final

import rhi
from renderer import rules
from renderer.lab.comparison import Column, Record, Subject, compare, ratio, time
from renderer.lab.measure.backends import BackendPasses
from renderer.scene import Camera, Scene
from rhi import refuse

COLUMNS: Final[dict[str, Column]] = {"milliseconds": time(), "ratio_to_gl": ratio(2, inverse=True)}


def compare_backends(
    scene: Scene, camera: Camera, backends: Sequence[str], passes: Sequence[str], size: tuple[int, int],
    rounds: Callable[[str], Iterable[int]], devices: dict[str, str],
) -> Iterator[Record]:  # fmt: skip
    """Yield a row for each pass on each backend. Backends alternate within a pass.

    Args:
        backends: names of backends; the others are compared with the first.
        passes: names in `renderer.lab.measure.backends.PASSES`.
        rounds: the rounds of a pass, by its name: a `range`, or a progress bar around one.
        devices: is given the names of the backends' devices.

    Raises:
        ValidationError: `measure-no-images` for a textured pass of a scene without images, `measure-no-pictures`
            for a backend that doesn't draw.
    """
    call = "compare_backends"
    if "textured" in passes and not scene.images:
        refuse(rules.NO_IMAGES, call, f"textured, of {scene.name}", "depth, lit, queries, waited")
    with ExitStack() as opened:
        made: dict[str, BackendPasses] = {}
        for backend in backends:
            device = opened.enter_context(rhi.create_device(backend))
            if not device.capabilities.renders:
                refuse(rules.NO_PICTURES, call, backend, "a backend that draws")
            made[backend] = one = BackendPasses(device, scene, camera, size)
            opened.callback(one.destroy)
            devices[backend] = device.capabilities.device
        for name in passes:
            subjects = [
                Subject({"pass": name, "backend": backend}, one.work(name), device=one.device)
                for backend, one in made.items()
            ]
            yield from compare(subjects, COLUMNS, rounds(name), warm_ups=2)
