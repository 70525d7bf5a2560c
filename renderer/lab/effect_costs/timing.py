"""Times that each effect step adds to a frame, and that remain once it is removed.

All renderers alternate in one process, and times are those of the processor in all threads, with 95 %
intervals.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from typing import Final

import rhi
from renderer.frame import VisibleFeatures, are_effects_same, collect_frame_effects
from renderer.lab.comparison import forget_commands
from renderer.lab.effect_costs.counting import StepRenderer, open_without_effect, remove_effect
from renderer.lab.effect_costs.effect_steps import move_eye
from renderer.lab.measure import Measurement, alternate
from renderer.lab.measure.measurement import Interval
from renderer.layers.overlay import Overlay

_WARM: Final = 12
"""Untimed frames at first: kernels are built and replaced by optimised ones."""
_COLLECTIONS: Final = 20
"""How often a frame's effects are collected in one measurement, so that a clock can tell the time."""


@dataclass(frozen=True, slots=True)
class EffectTime:
    """Processor milliseconds of a frame with all steps up to this one, and what this step adds."""

    frame: Interval
    added: Interval | None


def time_steps(device: rhi.Device, numbers: Sequence[int], rounds: Iterable[int]) -> dict[int, EffectTime]:
    """Time frames of the scenes of steps, one after the other in each round.

    A step adds its difference to the step before it.
    """
    drawn = sorted({step for number in numbers for step in (number - 1, number) if step >= 0})
    with ExitStack() as stack:
        step_renderers = {}
        for number in drawn:
            step_renderers[str(number)] = step_renderer = StepRenderer(device, number + 1)
            stack.callback(step_renderer.destroy)
        times = {
            int(name): time.in_milliseconds() for name, time in _alternate(step_renderers, rounds).items()
        }
    added = {number: times[number] - times[number - 1] for number in numbers if number - 1 in times}
    return {
        number: EffectTime(
            Interval.of(times[number]), Interval.of(added[number]) if number in added else None
        )
        for number in numbers
    }


def time_removal(device: rhi.Device, number: int, rounds: Iterable[int]) -> Interval:
    """The time of a frame from which an effect was removed, relative to a frame that never had it."""
    with ExitStack() as stack:
        never = open_without_effect(device, number)
        stack.callback(never.destroy)
        removed = remove_effect(device, number)
        stack.callback(removed.destroy)
        times = _alternate({"never": never, "removed": removed}, rounds)
    return Interval.of(times["removed"].in_milliseconds() / times["never"].in_milliseconds())


def _alternate(step_renderers: dict[str, StepRenderer], rounds: Iterable[int]) -> dict[str, Measurement]:
    """Time the next frames of all; each starts from the same camera in every round."""

    def draw(step_renderer: StepRenderer, _: int) -> None:
        step_renderer.render()
        step_renderer.renderer.device.finish()

    def prepare(name: str) -> None:
        device = step_renderers[name].renderer.device
        forget_commands(device)
        has_overlay = any(isinstance(layer, Overlay) for layer in step_renderers[name].renderer.layers)
        if device.timing != has_overlay and device.capabilities.timestamps:
            device.timing = has_overlay

    return alternate(
        {name: partial(draw, step_renderer) for name, step_renderer in step_renderers.items()},
        rounds,
        warm_ups=_WARM,
        before=prepare,
    )


@dataclass(frozen=True, slots=True)
class EffectCollectionTime:
    """The cost of collecting a frame's effects: microseconds, and the fraction of the frame's processor
    time."""

    microseconds: Interval
    fraction: Interval


def time_effect_collection(device: rhi.Device, rounds: int) -> EffectCollectionTime:
    """Time how long a frame of a scene with nothing but a box takes to find that its effects, of which there are
    none, are those of the frame before."""
    step_renderer = StepRenderer(device, 2)
    renderer, camera = (
        step_renderer.renderer,
        move_eye(0).with_aspect(step_renderer.renderer.size[0] / step_renderer.renderer.size[1]),
    )
    scene, features, reaches = (
        step_renderer.scene,
        VisibleFeatures(step_renderer.scene),
        renderer.resources.reaching,
    )
    effects = collect_frame_effects(
        scene,
        camera,
        reaches=reaches,
        visible_features=features.choose_shader_features(camera),
        shows_objects=features.shows_objects,
    )

    def ask(_: int) -> None:
        for _turn in range(_COLLECTIONS):
            visible_features = features.choose_shader_features(camera)
            assert are_effects_same(effects, scene, camera, visible_features, features.shows_objects, reaches)

    def draw(_: int) -> None:
        step_renderer.render()
        device.finish()

    times = alternate(
        {"ask": ask, "frame": draw}, range(rounds), warm_ups=_WARM, before=lambda _: forget_commands(device)
    )
    step_renderer.destroy()
    queried, drawn = times["ask"].in_milliseconds() / _COLLECTIONS, times["frame"].in_milliseconds()
    return EffectCollectionTime(Interval.of(1e3 * queried), Interval.of(queried / drawn))
