"""Frame plans: which passes run, and in which order, against brute force; and the passes of a scene without
lights."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from renderer.content import BUILT_IN
from renderer.frame import FramePass, Plan, Target, make_plan
from renderer.lab.exam.case import CaseResult, Measures
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene, SceneBuilder
from renderer.techniques import TECHNIQUES
from rhi import Device, Format, ValidationError, create_device

COUNT: Final = 300
_IMAGE: Final = (Target("image", Format.RGBA8_SRGB), Target("depth", Format.D32F))
_LIGHT_WORDS: Final = ("light", "shadow", "tile")


def _run_nothing(_: object) -> None:
    """Record nothing."""


def make_passes(rng: np.random.Generator) -> list[FramePass[object]]:
    """Make random passes in any order, which read resources of earlier passes or of the last frame, or draw
    over some."""
    passes: list[FramePass[object]] = []
    intact: list[str] = []
    for number in range(int(rng.integers(1, 10))):
        read_names = [name for name in intact if rng.random() < 0.4]
        last = tuple(name for name in intact if rng.random() < 0.1)
        over = {intact[-1]: f"c{number}"} if intact and rng.random() < 0.3 else {}
        reads = tuple(name for name in read_names if name not in over)
        passes.append(
            FramePass(
                f"p{number}",
                _run_nothing,
                "it is declared",
                reads=reads,
                writes=() if over else (Target(f"c{number}", Format.R8),),
                changes=over,
                reads_previous=last,
                has_side_effects=bool(rng.random() < 0.15),
            )
        )
        intact = [name for name in intact if name not in over] + [f"c{number}"]
    reads = tuple(name for name in intact if rng.random() < 0.4)
    passes.append(FramePass("image", _run_nothing, "it is declared", reads=reads, writes=_IMAGE))
    return [passes[row] for row in rng.permutation(len(passes))]


def collect_needed_passes(passes: Sequence[FramePass[object]]) -> set[str]:
    """The names of the passes that must run, found by adding missing ones until none is missing."""
    writers = {name: frame_pass for frame_pass in passes for name in _list_results(frame_pass)}
    needed = {frame_pass.name for frame_pass in passes if frame_pass.has_side_effects}
    needed |= {writers[name].name for name in list_outputs(passes)}
    while True:
        read = {
            name
            for frame_pass in passes
            if frame_pass.name in needed
            for name in (*frame_pass.reads, *frame_pass.changes, *frame_pass.reads_previous)
        }
        more = needed | {writers[name].name for name in read}
        if more == needed:
            return needed
        needed = more


def list_outputs(passes: Sequence[FramePass[object]]) -> list[str]:
    """The names of the frame's image and depth after the last passes."""
    over = {old: new for frame_pass in passes for old, new in frame_pass.changes.items()}
    last = ["image", "depth"]
    while any(name in over for name in last):
        last = [over.get(name, name) for name in last]
    return last


def _list_results(frame_pass: FramePass[object]) -> list[str]:
    written = [target.name if isinstance(target, Target) else target for target in frame_pass.writes]
    return [*written, *frame_pass.changes.values()]


def count_faults(plan: Plan[object], passes: Sequence[FramePass[object]]) -> int:
    """Count the passes that run needlessly or are missing, and the resources that aren't intact when they are
    read."""
    faults = len({frame_pass.name for frame_pass in plan.passes} ^ collect_needed_passes(passes))
    where = {name: row for row, texture in enumerate(plan.textures) for name in texture.names}
    holds: dict[int, str] = {}
    for frame_pass in plan.passes:
        faults += sum(holds.get(where[name]) != name for name in (*frame_pass.reads, *frame_pass.changes))
        holds |= {where[name]: name for name in _list_results(frame_pass)}
    has_history = {name for texture in plan.textures if texture.has_history for name in texture.names}
    faults += sum(name not in has_history for frame_pass in plan.passes for name in frame_pass.reads_previous)
    return faults + sum(holds.get(where[name]) != name for name in list_outputs(passes))


def _count_unrefused(make: Callable[[], object], rule: str) -> int:
    try:
        make()
    except ValidationError as error:
        return int(error.rule.id != rule)
    return 1


def _refuse_circle() -> int:
    def step(name: str, reads: str) -> FramePass[object]:
        return FramePass(
            name, _run_nothing, "it is declared", reads=(reads,), writes=(Target(name, Format.R8),)
        )

    final: FramePass[object] = FramePass(
        "final", _run_nothing, "it is declared", reads=("hen",), writes=_IMAGE
    )
    return _count_unrefused(lambda: make_plan([step("egg", "hen"), step("hen", "egg"), final]), "plan-cycle")


def make_plain_box(add_light: bool = False) -> Scene:
    """Make a box without effects, or with one light that casts shadows."""
    builder = SceneBuilder("box")
    builder.add_objects(builder.add_node(), builder.add_mesh(BUILT_IN["box"]()), builder.add_material())
    if add_light:
        builder.lights.add_point((0, 2, 0), 4.0, casts_shadow=True)
    return builder.build()


def _list_light_passes(device: Device, name: str, scene: Scene) -> list[str]:
    camera = Camera.look_at((0, 0, 10), (0, 0, 0))
    technique: Any = TECHNIQUES[name]()
    with Renderer(device, scene, technique=technique, visibility="none", size=(64, 32)) as renderer:
        renderer.render(camera)
        _, plan = renderer.plan(camera)
    return [
        frame_pass.name for frame_pass in plan.passes if any(word in frame_pass.name for word in _LIGHT_WORDS)
    ]


def measure_plans(_: Device) -> CaseResult:
    """Plan random frames and compare with brute force; refuse a circle; and plan scenes without lights and
    with one, with each technique on a null device."""
    rng = np.random.default_rng(51)
    faults, dropped, has_history = 0, 0, 0
    for _turn in range(COUNT):
        passes = make_passes(rng)
        plan = make_plan(passes)
        faults += count_faults(plan, passes)
        dropped += len(plan.dropped)
        has_history += sum(texture.has_history for texture in plan.textures)
    circle = _refuse_circle()
    numbers: dict[str, object] = {"faults of random plans": faults, "circles that aren't refused": circle}
    total, lit = faults + circle, 0
    with create_device("null") as null:
        for name in TECHNIQUES:
            without = _list_light_passes(null, name, make_plain_box())
            lit += len(_list_light_passes(null, name, make_plain_box(add_light=True)))
            if without:
                numbers[f"{name} without lights"] = without
            total += len(without)
    holds = {
        "some passes are dropped": dropped > COUNT // 10,
        "some contents survive their frame": has_history > COUNT // 20,
        "a local light has passes": lit >= len(TECHNIQUES) // 2,
    }
    return CaseResult(total, numbers, holds)


MEASURES: Final[Measures] = {51: measure_plans}
