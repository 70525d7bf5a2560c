"""What animations cost with nothing, half or all of the scene drawn: run everywhere, or only where they are drawn.

The scene is a row of boxes that turn, each on a node of its own. In one variant their animation has no bounds, so it
runs in every frame and its objects' bounds follow; in the other it has, so it runs for what is drawn. The camera sees
none of the boxes, half of them, or all; they are culled by the frustum, and the image is small. The variants take
turns, round by round, in one process; times are medians over the rounds, from the frame's begin until the device is
finished.

    python benchmarks/animation.py [--backend null] [--objects 2000] [--rounds 25] [--json]
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass

import numpy as np

import rhi
from renderer.content import BUILT_IN
from renderer.lab.measure import alternate
from renderer.renderer import Renderer
from renderer.scene import Camera, Orthographic, Recompute, Scene, SceneBuilder, rotation, translation
from renderer.visibility import FrustumCulling

SPACING = 3.0
VIEWS = {"nothing": 0.0, "half": 0.5, "everything": 1.0}
"""The share of the boxes that each view sees."""


class Turning:
    """Boxes that turn; `calls` and `computed` count what was asked for."""

    catch_up = Recompute()
    calls = 0
    computed = 0

    def __init__(self, places: np.ndarray) -> None:
        self.places = translation(places)
        self.angle = np.zeros(len(places))

    def set_time(self, members: np.ndarray, seconds: float) -> None:
        self.angle[members] = seconds + members

    def transforms(self, members: np.ndarray) -> np.ndarray:
        Turning.calls += 1
        Turning.computed += len(members)
        return self.places[members] @ rotation((0, 1, 0), self.angle[members])


@dataclass(frozen=True)
class Row:
    """The cost of a frame; `ratio` is that of the times, to running everywhere."""

    drawn: str
    run: str
    calls: float
    computed: float
    bytes: float
    milliseconds: float
    ratio: float


def make_scene(count: int, *, bounded: bool) -> Scene:
    """Make `count` boxes in a row along x."""
    builder = SceneBuilder("row")
    places = np.zeros((count, 3))
    places[:, 0] = SPACING * np.arange(count)
    nodes = builder.add_nodes(translation(places), dynamic=True)
    builder.add_objects(nodes, builder.add_mesh(BUILT_IN["box"]()), builder.add_material())
    half = np.array([0.75, 0.5, 0.75])
    builder.animate(nodes, Turning(places), (places - half, places + half) if bounded else None)
    return builder.build()


def look(count: int, share: float) -> Camera:
    """Return a camera that sees the first `share` of the boxes."""
    width = SPACING * max(count * share, 1.0)
    aim = np.array([0.5 * (width - SPACING), 0.0 if share else 1e6, 0.0])
    return Camera.look_at(aim + np.array([0.0, 0.0, 50.0]), aim, projection=Orthographic(width, aspect=1.0))


class Variant:
    """A scene and its renderer; `sums` are the calls, the members computed and the bytes of its frames."""

    def __init__(self, device: rhi.Device, scene: Scene) -> None:
        self.device = device
        self.renderer = Renderer(device, scene, visibility=FrustumCulling(scene), size=(64, 64))
        self.camera = look(1, 0.0)
        self.frames = 0
        self.sums = np.zeros(3)

    def draw(self) -> None:
        """Draw the next frame, and count what it took."""
        self.frames += 1
        Turning.calls = Turning.computed = 0
        result = self.renderer.render(self.camera, self.frames / 60)
        self.device.finish()
        self.sums += (Turning.calls, Turning.computed, result.statistics.upload_bytes)
        if self.device.backend_name == "null":
            self.device.stream.clear()


def measure(backend: str, count: int, rounds: int) -> list[Row]:
    """Return the cost of each view and variant."""
    rows = []
    with rhi.create_device(backend) as device:
        variants = {
            "everywhere": Variant(device, make_scene(count, bounded=False)),
            "where drawn": Variant(device, make_scene(count, bounded=True)),
        }
        work = {name: lambda _, one=one: one.draw() for name, one in variants.items()}
        for view, share in VIEWS.items():
            for one in variants.values():
                one.camera = look(count, share)
                one.draw()  # uploads what the view before has left
                one.draw()
                one.sums[:] = 0.0
            times = alternate(work, range(rounds), warm_ups=0)
            base = times["everywhere"]
            for name, one in variants.items():
                cost = (one.sums / rounds).tolist()
                rows.append(Row(view, name, *cost, 1e3 * times[name].median, times[name].compare_to(base).median))
        for one in variants.values():
            one.renderer.destroy()
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--backend", default="null", help="the device (default: %(default)s)")
    parser.add_argument("--objects", type=int, default=2000, help="animated boxes (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=25, help="rounds (default: %(default)s)")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    given = parser.parse_args()
    rows = measure(given.backend, given.objects, given.rounds)
    if given.json:
        print(json.dumps([asdict(row) for row in rows], indent=2))
        return
    print(f"{'drawn':12}{'run':14}{'calls':>8}{'computed':>10}{'bytes':>10}{'ms':>8}{'ratio':>8}")
    for row in rows:
        print(
            f"{row.drawn:12}{row.run:14}{row.calls:8.1f}{row.computed:10,.0f}{row.bytes:10,.0f}"
            f"{row.milliseconds:8.2f}{row.ratio:8.2f}"
        )


if __name__ == "__main__":
    main()
