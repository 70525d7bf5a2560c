"""Compares techniques: the cost of a frame of each, for several numbers of objects and lights (Wilks 2019).

- A scene's text names its generator; numbers of objects and lights are options of it. So nothing else
  changes, and the camera is the view of the same name.
- All techniques draw the same frame in turn with one renderer, without occlusion culling.
- Light evaluations are counted by the device (`light_evaluations`), bytes are those of the plan's textures,
  and draws are counted in the stream of commands that the null device records.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Final

from renderer import rules
from renderer.content import GENERATORS, parse_camera
from renderer.inspection.frame_cost import settle
from renderer.lab.comparison import Column, Frames, Record, Subject, compare, time
from renderer.lab.measure.light_evaluations import count_light_evaluations
from renderer.lab.measure.plan_report import describe_plan
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene
from renderer.settings import RenderSettings
from renderer.techniques import AutoTechnique, Technique
from rhi import Device, refuse

OPTIONS: Final = {"objects": "count", "lights": "lights"}
"""The options of scene generators that set the numbers of objects and of lights."""
COLUMNS: Final[dict[str, Column]] = {
    "milliseconds": time(),
    "processor_milliseconds": time(processor=True),
}
_WARM_UP_FRAMES: Final = 3
"""Untimed frames before a technique is timed: light lists grow to their size."""


def vary_scene(text: str, objects: int | None, lights: int | None) -> str:
    """Change the number of objects or lights in a scene's text; None leaves a number as it is.

    Raises:
        ValidationError `measure-fixed-scene`: its generator has no option for that, or it is a model file.
    """
    name, _, options = text.partition(":")
    option_names = {option.name for option in GENERATORS[name].options} if name in GENERATORS else set()
    parts = [options] if options else []
    for kind, number in (("objects", objects), ("lights", lights)):
        if number is None:
            continue
        if OPTIONS[kind] not in option_names:
            can = [
                generator.name
                for generator in GENERATORS.values()
                if OPTIONS[kind] in {o.name for o in generator.options}
            ]
            refuse(rules.FIXED_SCENE, f"vary_scene({text!r})", f"{kind} of {name}", ", ".join(can))
        parts.append(f"{OPTIONS[kind]}={number}")
    return f"{name}:{','.join(parts)}" if parts else text


def compare_techniques(
    device: Device,
    scenes: Iterable[Scene],
    techniques: Mapping[str, Technique],
    size: tuple[int, int],
    *,
    camera: str | None = None,
    frame: int = 0,
    rounds: int = 5,
    settings: RenderSettings | None = None,
    progress: Callable[[range], Iterable[int]] = lambda rounds: rounds,
) -> Iterator[Record]:
    """Yield a row for each scene and technique.

    Args:
        techniques: by the names of their rows.
        size: (width, height) of the image in pixels.
        camera, frame: as `parse_camera` reads them; by default the scene's first view.
        settings: all others; the technique is the row's, and the visibility algorithm is frustum culling.
    """
    frame_settings = (settings or RenderSettings()).change("algorithm", "frustum")
    for scene in scenes:
        view = frame_settings.adapt_camera(parse_camera(camera or next(iter(scene.views)), scene, frame))
        with frame_settings.open(device, scene, size) as renderer:
            subjects = [
                make_subject(renderer, name, technique, view) for name, technique in techniques.items()
            ]
            yield from compare(subjects, COLUMNS, progress(range(rounds)), warm_ups=_WARM_UP_FRAMES)


def make_subject(renderer: Renderer, name: str, technique: Technique, camera: Camera) -> Subject:
    """The subject of a technique, which is set in the renderer before each run.

    `AutoTechnique` ends its trial first; then the technique that it has chosen is counted."""
    scene, size, draw = renderer.scene, renderer.size, Frames(renderer, camera)

    def exchange() -> None:
        renderer.technique = technique
        settle(renderer, camera)  # what this creates isn't timed
        renderer.device.finish()

    def find() -> Record:
        """Count what is the same in every frame: light evaluations, bytes and draw commands."""
        renderer.technique = used = technique.current if isinstance(technique, AutoTechnique) else technique
        _, plan = renderer.plan(camera)
        return {
            "light_evaluations": count_light_evaluations(renderer, camera),
            "bytes_per_pixel": round(plan.count_bytes(size) / (size[0] * size[1]), 2),
            "draws": sum(pass_row.draws for pass_row in describe_plan(scene, used, camera, size).passes),
        }

    lights = len(scene.lights.point) + len(scene.lights.spot)
    labels = {"technique": name, "objects": len(scene.objects), "lights": lights}
    return Subject(labels, draw, exchange, summarize=find)
