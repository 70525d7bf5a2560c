"""Compares backends: the same passes of a scene, timed on each."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from typing import Final

import rhi
from renderer import rules
from renderer.lab.comparison import Column, Record, Subject, compare, ratio, time
from renderer.lab.measure.backend_passes import BackendPasses
from renderer.scene import Camera, Scene
from rhi import refuse

COLUMNS: Final[dict[str, Column]] = {"milliseconds": time(), "ratio_to_gl": ratio(2, inverse=True)}


def compare_backends(
    scene: Scene,
    camera: Camera,
    backends: Sequence[str],
    passes: Sequence[str],
    size: tuple[int, int],
    rounds: Callable[[str], Iterable[int]],
    devices: dict[str, str],
) -> Iterator[Record]:
    """Yield a row for each pass on each backend. Within a pass the backends take turns.

    Args:
        backends: names of backends; the others are compared with the first.
        passes: names in `renderer.lab.measure.backend_passes.PASSES`.
        rounds: the rounds of a pass, by its name: a `range`, or a progress bar around one.
        devices: filled with the name of each backend's device.

    Raises:
        ValidationError: `measure-no-images` for a textured pass of a scene without images,
            `measure-no-rendering` for a backend that doesn't draw.
    """
    call = "compare_backends"
    if "textured" in passes and not scene.images:
        refuse(rules.NO_IMAGES, call, f"textured, of {scene.name}", "depth, lit, queries, waited")
    with ExitStack() as opened:
        passes_by_backend: dict[str, BackendPasses] = {}
        for backend in backends:
            device = opened.enter_context(rhi.create_device(backend))
            if not device.capabilities.renders:
                refuse(rules.NO_RENDERING, call, backend, "a backend that draws")
            passes_by_backend[backend] = backend_passes = BackendPasses(device, scene, camera, size)
            opened.callback(backend_passes.destroy)
            devices[backend] = device.capabilities.device
        for name in passes:
            subjects = [
                Subject(
                    {"pass": name, "backend": backend},
                    backend_passes.work(name),
                    device=backend_passes.device,
                )
                for backend, backend_passes in passes_by_backend.items()
            ]
            yield from compare(subjects, COLUMNS, rounds(name), warm_ups=2)
