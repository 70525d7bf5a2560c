"""Comparison of techniques: what a frame of each costs, for several numbers of objects and lights (Wilks 2019).

- A scene's text names its generator; numbers of objects and lights are options of it. So nothing else changes, and the
  camera is the view of the same name.
- All techniques draw the same frame in turn in one process, without occlusion culling. Times are medians.
- Light evaluations are counted by the device (`light_evaluations`), bytes are those of the plan's textures, and draws
  are those of the frame's stream, which the null device records.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from renderer import rules
from renderer.content import GENERATORS, load_scene, parse_camera
from renderer.lab.measure.alternate import alternate
from renderer.lab.measure.light_evaluations import count_light_evaluations
from renderer.lab.measure.plans import describe_plan
from renderer.scene import Camera, Scene
from renderer.settings import RenderSettings
from renderer.techniques import Technique
from rhi import Device, refuse

OPTIONS = {"objects": "count", "lights": "lights"}
"""The options of generators that say how many objects and lights a scene has."""
_SETTLES = 3
"""Frames that a technique draws before it is timed: lists of lights learn how much room they need."""


@dataclass(frozen=True, slots=True)
class TechniqueRow:
    """The cost of a frame of one technique.

    Attributes:
        objects, lights: those of the scene; lights are point and spot lights.
        milliseconds: median time from the scene's update until the device is finished.
        processor_milliseconds: median processor time of all threads, which other programs disturb less.
        light_evaluations: how often a light is looked at for a surface; None if it can't be counted.
        bytes_per_pixel: size of the plan's textures. draws: number of draw commands.
    """

    technique: str
    objects: int
    lights: int
    milliseconds: float
    processor_milliseconds: float
    light_evaluations: int | None
    bytes_per_pixel: float
    draws: int


def vary_scene(text: str, objects: int | None, lights: int | None) -> str:
    """Return the text of the same scene with another number of objects or lights; None leaves it as it is.

    Raises:
        ValidationError `measure-fixed-scene`: its generator has no option for that, or it is a model file.
    """
    name, _, options = text.partition(":")
    known = {option.name for option in GENERATORS[name].options} if name in GENERATORS else set()
    parts = [options] if options else []
    for what, number in (("objects", objects), ("lights", lights)):
        if number is None:
            continue
        if OPTIONS[what] not in known:
            can = [one.name for one in GENERATORS.values() if OPTIONS[what] in {o.name for o in one.options}]
            refuse(rules.FIXED_SCENE, f"vary_scene({text!r})", f"{what} of {name}", ", ".join(can))
        parts.append(f"{OPTIONS[what]}={number}")
    return f"{name}:{','.join(parts)}" if parts else text


def compare_techniques(
    device: Device,
    text: str,
    techniques: dict[str, Technique],
    size: tuple[int, int],
    *,
    objects: Sequence[int | None] = (None,),
    lights: Sequence[int | None] = (None,),
    camera: str | None = None,
    frame: int = 0,
    rounds: int = 5,
    settings: RenderSettings | None = None,
    progress: Callable[[range], Iterable[int]] = lambda rounds: rounds,
) -> list[TechniqueRow]:
    """Return a row for each number of objects, number of lights, and technique.

    Args:
        text: the scene. objects, lights: numbers that replace the scene's own; None keeps them.
        techniques: by the names of their rows. size: (width, height) of the image in pixels.
        camera, frame: as `parse_camera` reads them; by default the scene's first view.
        settings: all but the technique and the visibility algorithm, which is frustum culling.

    Raises:
        ValidationError `measure-fixed-scene`: the scene has no option for numbers that are given.
    """
    rows = []
    for text_of_one in [vary_scene(text, count, number) for count in objects for number in lights]:
        scene = load_scene(text_of_one)
        view = parse_camera(camera or next(iter(scene.views)), scene, frame)
        chosen = (settings or RenderSettings()).change("algorithm", "frustum")
        rows += _compare(device, scene, chosen.aim(view), techniques, size, chosen, progress(range(rounds)))
    return rows


def _compare(
    device: Device,
    scene: Scene,
    camera: Camera,
    techniques: dict[str, Technique],
    size: tuple[int, int],
    settings: RenderSettings,
    rounds: Iterable[int],
) -> list[TechniqueRow]:
    with settings.open(device, scene, size) as renderer:

        def draw(_: int) -> None:
            renderer.render(camera)
            device.finish()

        def exchange(name: str) -> None:
            """Exchange the technique; what this creates isn't timed."""
            renderer.technique = techniques[name]
            draw(0)

        times = alternate(dict.fromkeys(techniques, draw), rounds, _SETTLES, before=exchange)
        rows = []
        for name, technique in techniques.items():
            renderer.technique = technique
            _, plan = renderer.plan(camera)
            report = describe_plan(scene, technique, camera, size)
            rows.append(
                TechniqueRow(
                    technique=name,
                    objects=len(scene.objects),
                    lights=len(scene.lights.point) + len(scene.lights.spot),
                    milliseconds=round(1e3 * times[name].median, 3),
                    processor_milliseconds=round(1e3 * times[name].processor_median, 3),
                    light_evaluations=count_light_evaluations(renderer, camera),
                    bytes_per_pixel=round(plan.count_bytes(size) / (size[0] * size[1]), 2),
                    draws=sum(one.draws for one in report.passes),
                )
            )
    return rows
