"""Faults of the renderer, one or more for each case of the exam, and a run of the exam against each of them.

A mutation replaces a piece of a module's text before the module is imported, so that Python code and shaders can be
broken alike. `python exam_mutations.py` prints a line of JSON for each case and mutation: whether it was seen.
With numbers of cases it tries only those.
"""

from __future__ import annotations

import importlib.util
import json
import multiprocessing
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import ModuleType
from typing import Any


@dataclass(frozen=True)
class Mutation:
    """A fault: in `module` the text `old`, which occurs once, is replaced by `new`."""

    cases: tuple[int, ...]
    fault: str
    module: str
    old: str
    new: str
    backend: str = "gl"


CHC = "renderer.visibility.queries.chc_plus_plus"
FOREST = "renderer.visibility.boxes.forest"
BOUNDS = "renderer.visibility.boxes.bounds"
PYRAMID = "renderer.visibility.gpu.depth_pyramid"
FARTHEST = "renderer.visibility.gpu.farthest_depth"
CELLS = "renderer.lights.culling.cells"
SPHERES = "renderer.lights.culling.sphere_tests"
CONES = "renderer.lights.culling.cone_tests"
ENCODINGS = "renderer.shaders.encodings"
EXACTLY = "    return not squared_distance(seen_from(cell, centre)) > radius * radius"

MUTATIONS: tuple[Mutation, ...] = (
    Mutation((1,), "a probability of 0.6 e^-t", CHC, "0.99 - 0.7 * exp(-t)", "0.99 - 0.6 * exp(-t)"),
    Mutation(
        (2,),
        "what is near isn't drawn",
        CHC,
        "        if forest.status[node] == NEAR:\n            self._show(node)",
        "        if forest.status[node] == NEAR:\n            return",
    ),
    Mutation(
        (3, 14),
        "nothing is near",
        FOREST,
        "status[boxes.near & (status == INSIDE)] = NEAR",
        "status[boxes.near & (status > INSIDE)] = NEAR",
    ),
    Mutation(
        (4,),
        "what enters the frustum isn't queried",
        CHC,
        "            self._i_queue.push(node)\n        elif",
        "            if was_visited:\n                self._i_queue.push(node)\n        elif",
    ),
    Mutation(
        (5,),
        "an answer that has to be waited for is none",
        "renderer.visibility.queries.box_queries",
        "samples = asked.wait()",
        "samples = asked.wait() * 0",
    ),
    Mutation(
        (6,),
        "a queue is queried only when it is full",
        CHC,
        "            elif self._i_queue or self._requery:",
        "            elif len(self._i_queue) >= self._batch or self._requery:",
    ),
    Mutation(
        (10, 52),
        "the first child isn't visited",
        FOREST,
        "        if status[child]:\n            self._add(child)\n",
        "",
    ),
    Mutation(
        (7, 15, 16, 19),
        "the second child isn't visited",
        FOREST,
        "        if status[child + 1]:\n            self._add(child + 1)\n",
        "",
    ),
    Mutation(
        (8,),
        "ten samples are none",
        "renderer.visibility.queries.box_queries",
        "return samples > self.threshold",
        "return samples > self.threshold + 10",
    ),
    Mutation(
        (9,),
        "visible leaves are asked in each frame",
        CHC,
        "if self._next_query[node] <= frame and not self._is_queried[node]:",
        "if not self._is_queried[node]:",
    ),
    Mutation(
        (21,),
        "query boxes are smaller than their objects",
        BOUNDS,
        "return 0.0, share + ROUNDING, steps",
        "return 0.0, -0.05, steps",
    ),
    Mutation(
        (11,),
        "a root that is a leaf isn't drawn",
        CHC,
        "        if forest.child[node] < 0:\n            self._render_queue.push(node)\n        else:",
        "        if forest.parent[node] < 0:\n            pass\n        elif forest.child[node] < 0:\n"
        "            self._render_queue.push(node)\n        else:",
    ),
    Mutation(
        (12,),
        "a ring takes one more",
        "rhi.device.core.containers",
        '        if count == self.capacity:\n            refuse(CONTAINER_FULL, "FixedQueue.push"',
        '        if count == self.capacity + 1:\n            refuse(CONTAINER_FULL, "FixedQueue.push"',
    ),
    Mutation(
        (13,),
        "a box beside the eye is hidden",
        PYRAMID,
        "            if not clip.w > 0.0:\n                return True",
        "            if not clip.w > 0.0:\n                return False",
    ),
    Mutation(
        (20,),
        "levels are read as if their widths were even",
        PYRAMID,
        "rows = [(*size, begin, 0) for",
        "rows = [(size[0] // 2 * 2, size[1], begin, 0) for",
    ),
    Mutation(
        (17,),
        "sky is left out of a texel",
        FARTHEST,
        "found = min(found, depth) if self.is_reversed",
        "found = (min(found, depth) if depth > 0.0 else found) if self.is_reversed",
    ),
    Mutation(
        (18,),
        "a rectangle has no more pixels than it covers",
        PYRAMID,
        "end = ivec2(clamp(floor(upper + self.margin), vec2(-1.0), size - 1.0))",
        "end = ivec2(clamp(floor(upper) - 1.0, vec2(-1.0), size - 1.0))",
    ),
    Mutation(
        (22,),
        "the exact test is that of planes",
        SPHERES,
        EXACTLY,
        "    return _meets_planes(seen_from(cell, centre), radius)",
    ),
    Mutation(
        (23,),
        "a sphere is a hundred-thousandth smaller",
        SPHERES,
        EXACTLY,
        "    return not squared_distance(seen_from(cell, centre)) > 0.99999 * radius * radius",
    ),
    Mutation(
        (24,),
        "a distance that equals the radius is outside",
        SPHERES,
        EXACTLY,
        "    return squared_distance(seen_from(cell, centre)) < radius * radius",
    ),
    Mutation(
        (25,),
        "a light behind the eye is culled",
        SPHERES,
        "if seen.near > radius or seen.far < -radius:",
        "if seen.near > 0.5 * radius or seen.far < -radius:",
    ),
    Mutation(
        (26,),
        "the first slice of a mask is rounded",
        CELLS,
        "first_bit = int(clamp(floor((low - near) * scale), 0.0, last))",
        "first_bit = int(clamp(floor((low - near) * scale + 0.5), 0.0, last))",
    ),
    Mutation(
        (27,),
        "distances aren't bounded by the grid",
        CELLS,
        "    if below == 0.0:\n        return grid.far\n"
        "    return clamp((grid.depth.x - grid.depth.y * depth) / below, grid.near, grid.far)",
        "    return (grid.depth.x - grid.depth.y * depth) / below",
    ),
    Mutation(
        (28,),
        "pixels are counted from 1",
        CELLS,
        "tile = pixel // grid.tile",
        "tile = (pixel + 1) // grid.tile",
    ),
    Mutation(
        (29,),
        "no grid begins before 0.1 m",
        "renderer.lights.culling.projections",
        "        near=near,\n        far=min",
        "        near=max(near, 0.1),\n        far=min",
    ),
    Mutation(
        (30,),
        "slices aren't bounded",
        CELLS,
        "index = int(clamp(floor(guess), 0.0, float(count - 1)))",
        "index = int(clamp(floor(guess), -9.0, float(count + 9)))",
    ),
    Mutation(
        (31,),
        "a tile is found by the reciprocal",
        CELLS,
        "tile = pixel // grid.tile",
        "tile = ivec2(floor(vec2(pixel) * (1.0 / float(grid.tile))))",
    ),
    Mutation(
        (32,),
        "a slice is what the logarithm says",
        CELLS,
        "    while index > 0 and z < slice_start(grid, index):\n        index -= 1\n"
        "    while index < count - 1 and z >= slice_start(grid, index + 1):\n        index += 1\n",
        "",
    ),
    Mutation(
        (33,),
        "cones of more than 90° don't reach behind",
        CONES,
        "behind = cone.cosine >= 0.0 and along < -radius",
        "behind = along < -radius",
    ),
    Mutation(
        (34,),
        "a cone opens backwards",
        CONES,
        "along = dot(place, cone.axis)\n",
        "along = -dot(place, cone.axis)\n",
    ),
    Mutation(
        (35,),
        "lists don't grow",
        "renderer.lights.culling.grid",
        "self.capacity = max(self.capacity, round_up(needed))",
        "pass",
    ),
    Mutation(
        (36,),
        "an eye's axis is that of the image",
        "renderer.lights.culling.projections",
        "slope=(clip * w_slope + shift) / scale",
        "slope=clip * w_slope / scale",
    ),
    Mutation(
        (37,),
        "the sign of 0 is 0",
        ENCODINGS,
        "return -1.0 if x < 0.0 else 1.0",
        "return -1.0 if x < 0.0 else 1.0 if x > 0.0 else 0.0",
    ),
    Mutation(
        (38,),
        "codes have no middle",
        ENCODINGS,
        "return normalize(fold_octahedron(vec2(code), steps))",
        "return normalize(fold_octahedron(vec2(code) + 0.5, steps))",
    ),
    Mutation(
        (39,),
        "lengths aren't bounded",
        ENCODINGS,
        "length = clamp(bits - _SMALLEST, 0, 8191)",
        "length = bits - _SMALLEST",
    ),
    Mutation((40,), "tangents turn about +z only", ENCODINGS, "half = away_from_zero(point.z)", "half = 1.0"),
    Mutation((41,), "65,535 steps", ENCODINGS, "round(fract(uv) * 65536.0)", "round(fract(uv) * 65535.0)"),
    Mutation(
        (42,),
        "a material's depth is a share of 65,536",
        ENCODINGS,
        "return float(row) / 65535.0",
        "return float(row) / 65600.0",
    ),
    Mutation(
        (43, 57, 68, 75),
        "places are single floats",
        "renderer.frame.mirrors",
        "return high, (positions - high).astype(np.float32)",
        "return high, np.zeros_like(high)",
    ),
    Mutation(
        (44,),
        "depth has 16 bits",
        "renderer.frame.targets",
        "DEPTH_FORMAT: Final = Format.D32F",
        "DEPTH_FORMAT: Final = Format.D16",
    ),
    Mutation(
        (45,),
        "lenses are skewed outwards",
        "renderer.scene.rigs",
        "-offset / self.convergence",
        "offset / self.convergence",
    ),
    Mutation(
        (46,),
        "eyes are never closer than a centimetre",
        "renderer.scene.rigs",
        "            return camera, camera\n",
        "            beside = camera.position + 0.01 * camera.right\n"
        "            return camera, Camera(beside, camera.rotation, camera.projection)\n",
    ),
    Mutation(
        (47,),
        "a coefficient is wrong in its second digit",
        "renderer.stereo.outputs",
        "(0.4561, 0.500484",
        "(0.4361, 0.500484",
    ),
    Mutation(
        (48,),
        "half the bias",
        "renderer.shadows.maps",
        "return SunTable(maps=filled, bias=(bias * _BIAS[0], bias * _BIAS[1], bias)",
        "return SunTable(maps=filled, bias=(0.0, 0.0, 0.5 * bias)",
    ),
    Mutation(
        (49,),
        "up is never parallel",
        "rhi.math.camera",
        "if np.linalg.norm(right) < 1e-9:",
        "if np.linalg.norm(right) < 0.0:",
    ),
    Mutation(
        (50,),
        "maps follow the eye",
        "renderer.shadows.cascades",
        "    place[:2] = np.floor(place[:2] / texel) * texel\n",
        "",
    ),
    Mutation(
        (51,),
        "what is read of the last frame isn't needed",
        "renderer.frame.plan",
        "for name in (*one.reads, *one.changes, *one.reads_last)",
        "for name in (*one.reads, *one.changes)",
    ),
    Mutation(
        (53,),
        "a parallel near plane cuts nothing",
        BOUNDS,
        "near = np.asarray(depth <= 0.0)",
        "near = np.asarray(depth <= -1e9)",
    ),
    Mutation(
        (54,),
        "a hundredth too much is separated",
        SPHERES,
        "return extent.x > reach or -extent.y > reach",
        "return extent.x > 0.99 * reach or -extent.y > reach",
    ),
    Mutation(
        (55,),
        "both eyes see what one does",
        "renderer.renderer",
        "view.aim(eye, around)",
        "view.aim(around, around)",
    ),
    Mutation(
        (56,),
        "levels are looked up in 256 steps",
        "renderer.stereo.mixing",
        "_STEPS: Final = 8192",
        "_STEPS: Final = 256",
    ),
    Mutation(
        (59,),
        "nothing is checked",
        "renderer.scene.finite",
        "if not np.isfinite(value).all():",
        "if value is None:",
        "null",
    ),
    Mutation(
        (60,),
        "a time is a millionth of a step early, ever",
        "renderer.scene.catching_up",
        "max(_EARLY, number * _ROUNDED)",
        "_EARLY",
        "null",
    ),
    Mutation(
        (65,),
        "a phase is a float",
        "renderer.content.hall",
        "np.sin(2.4 * seconds +",
        "np.sin(np.float32(2.4) * np.float32(seconds) +",
        "null",
    ),
    Mutation(
        (58,),
        "directions are divided by what may be too short",
        "renderer.scene.lights",
        "scaled = given / np.abs(given).max(axis=1, keepdims=True)",
        "scaled = given",
    ),
    Mutation(
        (61,),
        "boxes are counted with 16 bits",
        "renderer.visibility.boxes.hierarchy",
        "        self.order = np.arange(len(lower))\n",
        "        self.order = np.arange(len(lower)).astype(np.uint16).astype(np.int64)\n",
        "null",
    ),
    Mutation(
        (62,),
        "frames are kept",
        "renderer.renderer",
        "        frames = [left]\n",
        "        frames = [left]\n        self.__dict__.setdefault('kept', []).append(left)\n",
        "null",
    ),
    Mutation(
        (63,),
        "viewports end at 8,192 pixels",
        "rhi.backends.gl.states",
        "gl.Viewport(0, 0, *self._size)",
        "gl.Viewport(0, 0, *(min(side, 8192) for side in self._size))",
    ),
    Mutation(
        (64,),
        "images have two pixels or more",
        "renderer.techniques.parts.full_screen",
        "(width, height), matrix = size, camera.projection.matrix",
        "(width, height), matrix = (max(size[0], 2), max(size[1], 2)), camera.projection.matrix",
    ),
    Mutation(
        (66,),
        "rays have half precision",
        "renderer.techniques.parts.full_screen",
        "across=camera.rotation.T @ across",
        "across=(camera.rotation.T @ across).astype(np.float16).astype(np.float32)",
    ),
    Mutation(
        (67,),
        "the wind's phase is a float",
        "renderer.scene.cloth.cloths",
        "phases: Rows = (first[:, None] + self._later[members]) % self.wind.periods",
        "phases: Rows = (np.float32(first)[:, None] + self._later[members]).astype(np.int64) % self.wind.periods",
    ),
    Mutation(
        (67,),
        "nothing ends at a cloth's room",
        "renderer.scene.cloth.kernels",
        "            place = clamp(place, self.cloth.lower, self.cloth.upper)\n",
        "            place = clamp(place, self.cloth.lower - 9.0, self.cloth.upper + 9.0)\n",
    ),
    Mutation(
        (69,),
        "a coefficient of the tone map is another",
        "renderer.shaders.lighting",
        "(2.43 * color + 0.59)",
        "(2.43 * color + 0.49)",
    ),
    Mutation(
        (69,),
        "the image isn't sRGB",
        "renderer.frame.targets",
        "IMAGE_FORMAT: Final = Format.RGBA8_SRGB",
        "IMAGE_FORMAT: Final = Format.RGBA8",
    ),
    Mutation(
        (69,),
        "a lens is a fiftieth too narrow",
        "rhi.math.projections",
        "focal = 1.0 / np.tan(0.5 * self.fov)\n        near, far",
        "focal = 1.0 / np.tan(0.49 * self.fov)\n        near, far",
    ),
    Mutation(
        (69,),
        "normals aren't normalised",
        "renderer.techniques.parts.scene_shader",
        "return self.turn_side(self.bend(safe_normalize(v.normal), v))",
        "return self.turn_side(self.bend(v.normal, v))",
    ),
    Mutation(
        (69,),
        "light falls with the distance, not its square",
        "renderer.shaders.lighting",
        "return window * window / max(distance_squared, 1e-4)",
        "return window * window * inversesqrt(max(distance_squared, 1e-4))",
    ),
    Mutation(
        (69,),
        "the window of a lamp is another",
        "renderer.shaders.lighting",
        "window = saturate(1.0 - share * share)",
        "window = saturate(1.0 - share)",
    ),
    Mutation(
        (69,),
        "a spot fades linearly",
        "renderer.shaders.lighting",
        "(light.intensity * cone * cone * attenuation",
        "(light.intensity * cone * attenuation",
    ),
    Mutation(
        (69,),
        "highlights have half of their energy",
        "renderer.shaders.lighting",
        "(surface.shininess + 8.0) * 0.125",
        "(surface.shininess + 8.0) * 0.0625",
    ),
    Mutation(
        (69,),
        "the sky is below",
        "renderer.shaders.lighting",
        "0.5 + 0.5 * direction.y",
        "0.5 - 0.5 * direction.y",
    ),
    Mutation(
        (69,),
        "a metal's roughness isn't squared",
        "renderer.shaders.metals",
        "    alpha = roughness * roughness\n",
        "    alpha = roughness\n",
    ),
    Mutation(
        (69,),
        "v is read as u",
        "renderer.techniques.parts.scene_shader",
        "return vec3(dot(use.u, at), dot(use.v, at), use.layer)",
        "return vec3(dot(use.u, at), dot(use.u, at), use.layer)",
    ),
    Mutation(
        (69,),
        "the green of normal maps leads down",
        "renderer.techniques.parts.scene_shader",
        "(-1.0 if v.tangent.w < 0.0 else 1.0)",
        "(1.0 if v.tangent.w < 0.0 else -1.0)",
    ),
    Mutation(
        (70,),
        "light is squared however strong it is",
        "renderer.shaders.lighting",
        "color = min(color * 0.6, 1e4)",
        "color = color * 0.6",
    ),
    Mutation(
        (71,),
        "glass is drawn front to back",
        "renderer.frame.frame",
        'rows[np.argsort(-distances, kind="stable")]',
        'rows[np.argsort(distances, kind="stable")]',
    ),
    Mutation(
        (71,),
        "glass adds all of its light",
        "renderer.techniques.parts.transparency",
        "return vec4(seen.rgb * seen.a, seen.a)",
        "return vec4(seen.rgb, seen.a)",
    ),
    Mutation(
        (72,),
        "the series of level rays has another term",
        "renderer.shaders.fog",
        "return 1.0 - x * (0.5 - x",
        "return 1.0 - x * (0.9 - x",
    ),
    Mutation(
        (72,),
        "haze is by the square of the distance",
        "renderer.shaders.lighting",
        "exp(-haze.density * length(position))",
        "exp(-haze.density * dot(position, position))",
    ),
    Mutation(
        (72,),
        "the fog's height is that above the origin",
        "renderer.frame.air",
        "(float(frame.camera.position[1]) - fog.base)",
        "float(frame.camera.position[1])",
    ),
    Mutation(
        (73,),
        "normals turn as positions do",
        "renderer.frame.resources",
        "normal = normal_matrices(world)",
        "normal = world[:, :3, :3]",
    ),
    Mutation(
        (73,),
        "mirrored triangles keep their winding",
        "renderer.frame.resources",
        "mirrored = np.linalg.det(world[:, :3, :3]) < 0.0",
        "mirrored = np.linalg.det(world[:, :3, :3]) < -9e9",
    ),
    Mutation(
        (74,),
        "maps are read half a texel beside",
        "renderer.shadows.receiver",
        "        first = floor(at - 1.5)\n        share = at - 1.5 - first\n",
        "        first = floor(at - 1.0)\n        share = at - 1.0 - first\n",
    ),
)


class Mutant(MetaPathFinder):
    """Imports one module with a piece of its text replaced."""

    def __init__(self, mutation: Mutation, folder: Path) -> None:
        self.mutation, self.folder = mutation, folder

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != self.mutation.module:
            return None
        found = PathFinder.find_spec(fullname, path)
        assert found is not None
        assert found.origin is not None
        text = Path(found.origin).read_text()
        assert text.count(self.mutation.old) == 1, (fullname, self.mutation.old)
        broken = self.folder / Path(found.origin).name
        broken.write_text(text.replace(self.mutation.old, self.mutation.new))
        return importlib.util.spec_from_file_location(fullname, broken, loader=SourceFileLoader(fullname, str(broken)))


def examine_mutant(mutation: Mutation) -> dict[int, dict[str, Any]]:
    """Return how the cases of a mutation fail; in a process in which the renderer wasn't imported yet."""
    with tempfile.TemporaryDirectory() as folder:
        sys.meta_path.insert(0, Mutant(mutation, Path(folder)))
        import rhi
        from renderer.lab.exam import CASES, examine

        with rhi.create_device(mutation.backend) as device:
            rows = list(examine(device, [CASES[number] for number in mutation.cases]))
    return {row.case: {"seen": row.passed is False, "error": str(row.error), "remark": row.remark} for row in rows}


def try_mutations(mutations: Sequence[Mutation]) -> Iterator[dict[str, Any]]:
    """Try each mutation in a process of its own, and yield the results."""
    spawn = multiprocessing.get_context("spawn")
    with spawn.Pool(2, maxtasksperchild=1) as pool:
        for mutation, found in zip(mutations, pool.imap(examine_mutant, mutations, chunksize=1), strict=True):
            for number, row in found.items():
                yield {"case": number, "fault": mutation.fault, **row}


if __name__ == "__main__":
    numbers = set(map(int, sys.argv[1:]))
    chosen = [one for one in MUTATIONS if not numbers or numbers & set(one.cases)]
    for result in try_mutations(chosen):
        print(json.dumps(result), flush=True)
