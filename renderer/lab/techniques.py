"""Comparison of techniques: what a frame of each costs, for several numbers of objects and lights (Wilks 2019).

- A scene's text names its generator; numbers of objects and lights are options of it. So nothing else changes, and the
  camera is the view of the same name.
- All techniques draw the same frame in turn with one renderer, without occlusion culling.
- Light evaluations are counted by the device (`light_evaluations`), bytes are those of the plan's textures, and draws
  are those of the frame's stream, which the null device records.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Final

from renderer import rules
from renderer.content import GENERATORS, parse_camera
from renderer.lab.comparison import Column, Frames, Record, Subject, compare, time
from renderer.lab.measure.frames import settle
from renderer.lab.measure.light_evaluations import count_light_evaluations
from renderer.lab.measure.plans import describe_plan
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene
from renderer.settings import RenderSettings
from renderer.techniques import AutoTechnique, Technique
from rhi import Device, refuse

OPTIONS: Final = {"objects": "count", "lights": "lights"}
"""The options of generators that say how many objects and lights a scene has."""
COLUMNS: Final[dict[str, Column]] = {
    "milliseconds": time(), "processor_milliseconds": time(processor=True),
}  # fmt: skip
_SETTLES: Final = 3
"""Frames that a technique draws before it is timed: lists of lights learn how much room they need."""


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
    device: Device, scenes: Iterable[Scene], techniques: Mapping[str, Technique], size: tuple[int, int], *,
    camera: str | None = None, frame: int = 0, rounds: int = 5, settings: RenderSettings | None = None,
    progress: Callable[[range], Iterable[int]] = lambda rounds: rounds,
) -> Iterator[Record]:  # fmt: skip
    """Yield a row for each scene and technique.

    Args:
        techniques: by the names of their rows. size: (width, height) of the image in pixels.
        camera, frame: as `parse_camera` reads them; by default the scene's first view.
        settings: all but the technique and the visibility algorithm, which is frustum culling.
    """
    chosen = (settings or RenderSettings()).change("algorithm", "frustum")
    for scene in scenes:
        view = chosen.aim(parse_camera(camera or next(iter(scene.views)), scene, frame))
        with chosen.open(device, scene, size) as renderer:
            subjects = [make_subject(renderer, name, one, view) for name, one in techniques.items()]
            yield from compare(subjects, COLUMNS, progress(range(rounds)), warm_ups=_SETTLES)


def make_subject(renderer: Renderer, name: str, technique: Technique, camera: Camera) -> Subject:
    """Return the subject of a technique, which takes the place of another one in the renderer before it is timed.

    Of `AutoTechnique`, which first ends its trial, what is counted is that of the technique that it has chosen."""
    scene, size, draw = renderer.scene, renderer.size, Frames(renderer, camera)

    def exchange() -> None:
        renderer.technique = technique
        settle(renderer, camera)  # what this creates isn't timed
        renderer.device.finish()

    def find() -> Record:
        """Count what doesn't change from frame to frame: lights that are looked at, bytes and draw commands."""
        renderer.technique = used = technique.current if isinstance(technique, AutoTechnique) else technique
        _, plan = renderer.plan(camera)
        return {
            "light_evaluations": count_light_evaluations(renderer, camera),
            "bytes_per_pixel": round(plan.count_bytes(size) / (size[0] * size[1]), 2),
            "draws": sum(one.draws for one in describe_plan(scene, used, camera, size).passes),
        }

    lights = len(scene.lights.point) + len(scene.lights.spot)
    about = {"technique": name, "objects": len(scene.objects), "lights": lights}
    return Subject(about, draw, exchange, find=find)
