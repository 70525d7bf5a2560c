"""Plans of frames: what runs, and in which order, against brute force; and what a scene without lights has."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from renderer.content import BUILT_IN
from renderer.frame import Pass, Plan, Target, make_plan
from renderer.lab.exam.case import Found, Measures
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene, SceneBuilder
from renderer.techniques import TECHNIQUES
from rhi import Device, Format, ValidationError, create_device

COUNT: Final = 300
_IMAGE: Final = (Target("image", Format.RGBA8_SRGB), Target("depth", Format.D32F))
_LAMPS: Final = ("light", "shadow", "tile", "lamp")


def _run_nothing(_: object) -> None:
    """Run nothing."""


def make_passes(rng: np.random.Generator) -> list[Pass[object]]:
    """Make random passes, in any order, each of which reads contents of earlier ones, of the last frame, or draws over
    some."""
    passes: list[Pass[object]] = []
    intact: list[str] = []
    for number in range(int(rng.integers(1, 10))):
        some = [name for name in intact if rng.random() < 0.4]
        last = tuple(name for name in intact if rng.random() < 0.1)
        over = {intact[-1]: f"c{number}"} if intact and rng.random() < 0.3 else {}
        reads = tuple(name for name in some if name not in over)
        passes.append(
            Pass(
                f"p{number}", _run_nothing, "it is declared", reads=reads,
                writes=() if over else (Target(f"c{number}", Format.R8),), changes=over, reads_last=last,
                has_side_effects=bool(rng.random() < 0.15),
            )
        )  # fmt: skip
        intact = [name for name in intact if name not in over] + [f"c{number}"]
    reads = tuple(name for name in intact if rng.random() < 0.4)
    passes.append(Pass("image", _run_nothing, "it is declared", reads=reads, writes=_IMAGE))
    return [passes[row] for row in rng.permutation(len(passes))]


def find_needed(passes: Sequence[Pass[object]]) -> set[str]:
    """Return the names of the passes that must run, by adding what is missing until nothing is."""
    writers = {name: one for one in passes for name in _list_results(one)}
    needed = {one.name for one in passes if one.has_side_effects}
    needed |= {writers[name].name for name in find_outputs(passes)}
    while True:
        read = {name for one in passes if one.name in needed for name in (*one.reads, *one.changes, *one.reads_last)}
        more = needed | {writers[name].name for name in read}
        if more == needed:
            return needed
        needed = more


def find_outputs(passes: Sequence[Pass[object]]) -> list[str]:
    """Return the names of the frame's image and depth as the last passes leave them."""
    over = {old: new for one in passes for old, new in one.changes.items()}
    last = ["image", "depth"]
    while any(name in over for name in last):
        last = [over.get(name, name) for name in last]
    return last


def _list_results(one: Pass[object]) -> list[str]:
    written = [target.name if isinstance(target, Target) else target for target in one.writes]
    return [*written, *one.changes.values()]


def count_faults(plan: Plan[object], passes: Sequence[Pass[object]]) -> int:
    """Count the passes that run needlessly or are missing, and the contents that aren't intact when they are read."""
    faults = len({one.name for one in plan.passes} ^ find_needed(passes))
    where = {name: row for row, texture in enumerate(plan.textures) for name in texture.names}
    holds: dict[int, str] = {}
    for one in plan.passes:
        faults += sum(holds.get(where[name]) != name for name in (*one.reads, *one.changes))
        holds |= {where[name]: name for name in _list_results(one)}
    kept = {name for texture in plan.textures if texture.kept for name in texture.names}
    faults += sum(name not in kept for one in plan.passes for name in one.reads_last)
    return faults + sum(holds.get(where[name]) != name for name in find_outputs(passes))


def _count_unrefused(make: Callable[[], object], rule: str) -> int:
    try:
        make()
    except ValidationError as error:
        return int(error.rule.id != rule)
    return 1


def _refuse_circle() -> int:
    def step(name: str, reads: str) -> Pass[object]:
        return Pass(name, _run_nothing, "it is declared", reads=(reads,), writes=(Target(name, Format.R8),))

    final: Pass[object] = Pass("final", _run_nothing, "it is declared", reads=("hen",), writes=_IMAGE)
    return _count_unrefused(lambda: make_plan([step("egg", "hen"), step("hen", "egg"), final]), "plan-circle")


def make_plain_box(add_lamp: bool = False) -> Scene:
    """Make a box without effects, or with one lamp that casts shadows."""
    builder = SceneBuilder("box")
    builder.add_objects(builder.add_node(), builder.add_mesh(BUILT_IN["box"]()), builder.add_material())
    if add_lamp:
        builder.lights.add_point((0, 2, 0), 4.0, casts_shadow=True)
    return builder.build()


def _list_lamp_passes(device: Device, name: str, scene: Scene) -> list[str]:
    camera = Camera.look_at((0, 0, 10), (0, 0, 0))
    technique: Any = TECHNIQUES[name]()
    with Renderer(device, scene, technique=technique, visibility="none", size=(64, 32)) as renderer:
        renderer.render(camera)
        _, plan = renderer.plan(camera)
    return [one.name for one in plan.passes if any(word in one.name for word in _LAMPS)]


def plan_frames(_: Device) -> Found:
    """Plan random frames and compare with brute force; refuse a circle; and plan scenes without lights and with one,
    with each technique on a null device."""
    rng = np.random.default_rng(51)
    faults, dropped, kept = 0, 0, 0
    for _turn in range(COUNT):
        passes = make_passes(rng)
        plan = make_plan(passes)
        faults += count_faults(plan, passes)
        dropped += len(plan.dropped)
        kept += sum(texture.kept for texture in plan.textures)
    circle = _refuse_circle()
    numbers: dict[str, object] = {"faults of random plans": faults, "circles that aren't refused": circle}
    total, lit = faults + circle, 0
    with create_device("null") as null:
        for name in TECHNIQUES:
            without = _list_lamp_passes(null, name, make_plain_box())
            lit += len(_list_lamp_passes(null, name, make_plain_box(add_lamp=True)))
            if without:
                numbers[f"{name} without lights"] = without
            total += len(without)
    holds = {
        "some passes are dropped": dropped > COUNT // 10,
        "some contents survive their frame": kept > COUNT // 20,
        "a lamp has passes": lit >= len(TECHNIQUES) // 2,
    }
    return Found(total, numbers, holds)


MEASURES: Final[Measures] = {51: plan_frames}
