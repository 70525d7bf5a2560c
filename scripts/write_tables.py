"""Make figures of the docs again: `python scripts/write_tables.py [--check | --ratios] [NAME …]`.

The mark `<!-- table: NAME -->` stands in a page on the line above a table. `TABLES[NAME]` finds the cells of
some of its columns. Those that don't depend on time are written into the page. With `--check` nothing is
written: what differs is printed, and the exit code is 1 then. The nightly tests do so with all of them.

Times differ from one machine to another, ratios less so. With `--ratios`, the times of each row are divided
by those of the first one, and the ratios of the page are printed beside those of this machine.

Counts of occlusion queries that are answered while a frame is drawn depend a little on when:
`MeasuredTable.tolerance` says by how much they may differ from the page. Rows that aren't found stay as they
are.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any, Final

import numpy as np

ROOT: Final = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import rhi  # noqa: E402
from renderer.content import load_scene, parse_camera  # noqa: E402
from renderer.lab.comparisons.visibility_comparison import Contender, compare_algorithms, list_frames  # noqa: E402
from renderer.lab.exam.case import COMPUTES, DRAWS, NOTHING  # noqa: E402
from renderer.light_kinds.table import LOCAL_LIGHT_KINDS  # noqa: E402
from renderer.lights.object_lists import list_lights  # noqa: E402
from renderer.renderer import Renderer  # noqa: E402
from renderer.stereo import Stereo, compute_rig  # noqa: E402
from renderer.techniques import Forward, Inferred  # noqa: E402
from renderer.visibility import VisibilitySettings  # noqa: E402

Cells = Mapping[str, Sequence[str]]
"""The cells of some columns, by the first cell of their row."""


@dataclass(frozen=True, slots=True)
class MeasuredTable:
    """A table of a page: `compute` finds the cells of its `columns`, then those of `times`, by a row's first
    cell.

    Attributes:
        tolerance: the share by which numbers of `columns` may differ from those of the page.
    """

    page: str
    columns: tuple[str, ...]
    compute: Callable[[], Cells]
    times: tuple[str, ...] = ()
    tolerance: float = 0.0


def _read_report(*arguments: str) -> Any:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, *arguments, "--json"],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
        encoding="utf-8",
    )
    return json.loads(done.stdout)


def _significant(value: float, digits: int) -> str:
    """Return a number with so many significant digits."""
    return (
        np.format_float_positional(value, digits, fractional=False, trim="-")
        if value < 1e3
        else f"{float(f'{value:.{digits - 1}e}'):,.0f}"
    )


def count_order_changes() -> Cells:
    """Count what changes between the draws of `bazaar`, in several orders of its objects."""
    names = ("programs", "materials", "meshes", "draws")
    orders = _read_report("-m", "renderer", "plan", "bazaar", "--technique", "forward")["orders"]
    return {row["order"]: [f"{row[name]:,}" for name in names] for row in orders}


def measure_encodings() -> Cells:
    """Find the errors of encodings against float64, the larger ones of gl and cl."""
    rows = _read_report("-m", "renderer", "compare", "encodings")["rows"]
    return {
        row["name"]: [
            _significant(row["mean_error"], 2),
            _significant(row["max_error"], 3),
            *(str(row["nanoseconds"][backend]) for backend in ("gl", "cl")),
        ]
        for row in rows
    }


def compare_inferred() -> Cells:
    """Compare images of inferred lighting at several scales with forward shading's, on gl."""
    scene = load_scene("hall")
    camera = parse_camera("overview", scene)
    with (
        rhi.create_device("gl") as device,
        Renderer(device, scene, technique=Forward(), size=(480, 270)) as renderer,
    ):
        reference = renderer.render(camera).image.read()[..., :3].astype(np.float64)
        rows = {}
        for scale in (1, 0.8, 0.6, 0.5, 0.4):
            renderer.technique = Inferred(scale=scale)
            off = np.abs(renderer.render(camera).image.read()[..., :3] - reference)
            loudness = 10 * np.log10(255**2 / np.square(off).mean())
            rows[f"{scale}"] = [f"{loudness:.1f}", f"{100 * np.mean(off.max(-1) > 2):.2g} %"]
    return rows


def count_light_lists() -> Cells:
    """Count the objects, the lights on the lists of all of them, and those on the longest list."""
    rows = {}
    for name in ("night:lights=64", "night:lights=512", "night:lights=4096", "hall:lights=4096"):
        scene = load_scene(name)
        spheres = [kind.bound_lights(scene.lights.of_kind(kind)) for kind in LOCAL_LIGHT_KINDS]
        centers, radii = (np.concatenate(parts) for parts in zip(*spheres, strict=True))
        ends, _ = list_lights(scene.objects.lower, scene.objects.upper, centers, radii)
        rows[f"`{name}`"] = [f"{len(scene.objects):,}", f"{ends[-1]:,}, {np.diff(ends).max():,}"]
    return rows


def sum_memory() -> Cells:
    """Sum the bytes of what the renderer holds of `bazaar`."""
    memory = _read_report("-m", "renderer", "plan", "bazaar", "--technique", "forward")["memory"]
    sizes = {row["name"]: row["bytes"] for row in memory["rows"]}
    groups = {
        "`maps`": ("maps",),
        "`images`": ("images",),
        "vertices, indices": ("meshes vertices", "meshes indices"),
        "`image` and `depth`": ("image", "depth"),
        "`objects`, `object_positions`, `batch`": ("objects", "object_positions", "batch"),
        "`light rows`, `point lights`": ("light rows", "point lights"),
        "`materials`, `textures`": ("materials", "textures"),
        "constants": ("ViewConstants", "Ambient"),
    }
    rows = {group: [f"{sum(sizes[name] for name in names):,}"] for group, names in groups.items()}
    return {**rows, "all": [f"{memory['bytes']:,}"]}


def compare_reprojected() -> Cells:
    """Compare right eyes' images that were reprojected, and left eyes', with those that are drawn, on gl."""
    rows = {}
    with rhi.create_device("gl") as device:
        for name, pose in (
            ("city", "ground"),
            ("city", "overview"),
            ("hall", "ground"),
            ("glass", "overview"),
            ("bazaar", "corner"),
        ):
            scene = load_scene(name)
            camera = parse_camera(pose, scene, frame=900).with_aspect(16 / 9)
            rig = compute_rig(scene, camera)
            with Renderer(device, scene, size=(960, 270), visibility="frustum") as renderer:
                drawn, images = (
                    [eye.read()[..., :3].astype(np.float64) for eye in renderer.render(camera).eye_images]
                    for renderer.stereo in (
                        Stereo(rig, "side_by_side", is_reprojected=image) for image in (False, True)
                    )
                )
            errors = (np.abs(image - drawn[1]).mean() for image in (images[1], drawn[0]))
            rows[f"{name}, {pose}"] = [f"{error:.2f}" for error in errors]
    return rows


def count_leaf_sizes() -> Cells:
    """Count queries and objects of the city with leaves of several sizes, on gl."""
    scene, rows = load_scene("city"), {}
    contenders = [
        Contender(f"{name}, {size}", name, VisibilitySettings(leaf_size=size))
        for name, sizes in (
            ("stop_and_wait", (1,)),
            ("chc", (1, 2, 4, 8, 16)),
            ("chc_plus_plus", (1, 2, 4, 8, 16)),
        )
        for size in sizes
    ]
    with (
        rhi.create_device("gl") as device,
        Renderer(device, scene, size=(192, 108), visibility="frustum") as renderer,
    ):
        for path in ("ground", "sky"):
            frames = list_frames(600, 16, len(scene.paths[path]))
            for row in compare_algorithms(renderer, contenders, scene.paths[path], frames):
                rows[f"{path}, {row['algorithm']}"] = [f"{row['queries']}", f"{row['draws']}"]
    return rows


def _compare_in_city(arguments: str) -> Any:
    return _read_report(
        "-m", "renderer", "compare", "visibility", "city", "--backend", "gl", *arguments.split()
    )["rows"]


def count_visibility_work() -> Cells:
    """Count what algorithms draw, query and change on the whole path at ground level, on gl; hardware states,
    a few each, not where they follow from when the device answers."""
    names = ("triangles", "draws", "queries", "software_state_changes", "hardware_state_changes")
    report = _compare_in_city(
        "--camera-path ground --frames 60 --stride 30 --frame 12 --warm-up 4 --size 960x540"
        " --algorithms frustum,stop_and_wait,chc_plus_plus,depth_pyramid,two_pass"
    )
    last = {"chc_plus_plus": 4, "depth_pyramid": 4}
    return {
        row["algorithm"]: [f"{row[name]:,.0f}" for name in names[: last.get(row["algorithm"])]]
        for row in report
    }


def count_warm_up() -> Cells:
    """Count what CHC and CHC++ draw and query in 60 far frames, by the number of frames before each."""
    rows = {}
    for before in (0, 1, 4, 8, 29):
        report = _compare_in_city(
            f"--size 192x108 --algorithms chc,chc_plus_plus --frames 60 --stride 30 --warm-up {before}"
            f" --frame {29 - before}"
        )
        rows[f"{before}"] = [
            f"{row[name]:,.0f}" for row in report for name in ("triangles", "draws", "queries")
        ]
    return rows


def _describe_error(error: float | None) -> str:
    """Return an error with two decimals, or with two digits if it is small."""
    if error is None:
        return "-"
    return f"{error:.2f}" if error == 0.0 or error >= 0.1 else f"{error:.2g}"


def measure_by_rays() -> Cells:
    """Measure errors of quality settings on gl and cl: to ray-traced images, and to the best value's."""
    return _measure_errors("city:blocks=4", RAY_TRACED_SETTINGS, rounds=1)


def measure_effects() -> Cells:
    """Measure errors of the quality settings of effects on gl and cl, each in a scene that has the effect, and the
    ratios of their times."""
    cells: dict[str, Sequence[str]] = {}
    for scene, names in EFFECT_SETTINGS.items():
        cells |= _measure_errors(scene, names, rounds=3, times=True)
    return cells


def _measure_errors(scene: str, names: Sequence[str], *, rounds: int, times: bool = False) -> Cells:
    """Return the errors of each value on gl and on cl, and after those, if asked for, the ratios of times."""
    errors: dict[str, list[str]] = {}
    ratios: dict[str, list[str]] = {}
    settings = [f"--quality-setting={name}" for name in names]
    for backend in ("gl", "cl"):
        options = f"{scene} --backend {backend} --size 96x54 --views 1 --rounds {rounds}"
        report = _read_report("-m", "renderer", "accuracy", *options.split(), *settings)
        for setting in report["quality_settings"]:
            for row in setting["rows"]:
                value = f"**{row['value']}**" if row["is_default"] else row["value"]
                title = f"`{row['setting']}`: {value}"
                cells = map(_describe_error, (row["mean_error"], row["difference"]))
                errors.setdefault(title, []).extend(cells)
                ratios.setdefault(title, []).append(f"{row['processor_ratio']:.2f}")
    of_both = [title for title, cells in errors.items() if len(cells) == 4]
    return {title: [*errors[title], *(ratios[title] if times else ())] for title in of_both}


def count_useless() -> Cells:
    """Count the cases of the exam that devices of no use pass, on gl."""
    report = _read_report("tests/meta/useless_devices.py")
    return {
        name: [str(len(passed[asked])) for asked in (DRAWS, COMPUTES, NOTHING)]
        for name, passed in report.items()
    }


RAY_TRACED_SETTINGS: Final = (
    "samples",
    "fxaa",
    "texture_filter",
    "shadow_size",
    "shadow_cascades",
    "shadow_filter",
    "shadow_bias",
)
"""The quality settings of the table whose errors are distances from ray-traced images."""
EFFECT_SETTINGS: Final = {
    "city:blocks=4": ("temporal", "temporal_deviations", "temporal_bits"),
    "city:blocks=4,shadows=1,sun_degrees=3": ("blocker_samples", "penumbra_samples"),
    "city:blocks=4,occlusion=2": (
        "occlusion_slices",
        "occlusion_steps",
        "occlusion_smoothing",
        "occlusion_bits",
    ),
    "city:blocks=4,focus=12,aperture=0.3": ("focus_samples", "focus_radius", "focus_bits"),
    "yard:environment=1": ("environment_samples", "environment_size"),
    "night:bloom=0.2": ("bloom_levels", "bloom_karis_average", "bloom_bits"),
}
"""The quality settings of effects, by a scene that has the effect."""

TABLES: Final = {
    "by rays": MeasuredTable(
        "docs/measurements/accuracy.md",
        ("gl: error", "gl: to best", "cl: error", "cl: to best"),
        measure_by_rays,
        tolerance=0.1,
    ),
    "effects": MeasuredTable(
        "docs/measurements/accuracy.md",
        ("gl: error", "gl: to best", "cl: error", "cl: to best"),
        measure_effects,
        ("gl: time", "cl: time"),
        tolerance=0.1,
    ),
    "orders": MeasuredTable(
        "docs/measurements/material-costs.md",
        ("programs", "materials", "meshes", "draws"),
        count_order_changes,
    ),
    "encodings": MeasuredTable(
        "docs/measurements/deferred-plus-costs.md",
        ("mean error", "largest error"),
        measure_encodings,
        ("ns, gl", "ns, cl"),
    ),
    "inferred": MeasuredTable(
        "docs/measurements/lighting-measured.md",
        ("PSNR, dB", "pixels more than 2 of 255 off"),
        compare_inferred,
    ),
    "light lists": MeasuredTable(
        "docs/measurements/lighting-measured.md",
        ("objects", "lights listed, longest list"),
        count_light_lists,
    ),
    "memory": MeasuredTable("docs/measurements/material-costs.md", ("bytes",), sum_memory),
    "useless devices": MeasuredTable(
        "docs/measurements/exam-results.md", (DRAWS, COMPUTES, NOTHING), count_useless
    ),
    "reprojected": MeasuredTable(
        "docs/measurements/stereo-costs.md", ("reprojected", "the left eye's"), compare_reprojected
    ),
    "ground level": MeasuredTable(
        "docs/measurements/visibility-tables.md",
        ("triangles", "draws", "queries", "software states", "hardware states"),
        count_visibility_work,
        tolerance=0.1,
    ),
    "frames before": MeasuredTable(
        "docs/measurements/visibility-tables.md",
        tuple(
            f"{name}: {what}"
            for name in ("chc", "chc_plus_plus")
            for what in ("triangles", "draws", "queries")
        ),
        count_warm_up,
        tolerance=0.1,
    ),
    "leaf sizes": MeasuredTable(
        "docs/measurements/visibility-costs.md", ("queries", "draws"), count_leaf_sizes, tolerance=0.25
    ),
}
"""The tables that are made again, by the names of their marks."""


def _split(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def parse_table(text: str, name: str, rows: Cells) -> tuple[list[str], dict[int, list[str]]]:
    """Return, of the table of this name, the titles of its columns, and the cells of its rows by line.

    Raises:
        ValueError: there is no such table, or it lacks a row.
    """
    lines = text.split("\n")
    mark = f"<!-- table: {name} -->"
    if mark not in lines:
        raise ValueError(f"no line {mark}")
    first = lines.index(mark) + 1
    end = next(
        (number for number in range(first, len(lines)) if not lines[number].startswith("|")), len(lines)
    )
    cells = {number: _split(lines[number]) for number in range(first + 2, end)}
    seen = [row[0] for row in cells.values()]
    if not rows or not set(rows) <= set(seen):
        raise ValueError(f"{name}: the page has rows {seen}, and found are {list(rows)}")
    return _split(lines[first]), {number: row for number, row in cells.items() if row[0] in rows}


def replace_cells(text: str, name: str, columns: Sequence[str], rows: Cells) -> str:
    """Return a page with other cells in some columns of its table of this name."""
    titles, cells = parse_table(text, name, rows)
    lines = text.split("\n")
    for number, row in cells.items():
        for column, cell in zip(columns, rows[row[0]], strict=False):  # times follow
            row[titles.index(column)] = cell
        lines[number] = f"| {' | '.join(row)} |"
    return "\n".join(lines)


def list_ratios(text: str, name: str, figure: MeasuredTable, rows: Cells) -> Iterator[str]:
    """Yield the ratios of times to those of the first row: of the page, and those that were found."""
    titles, cells = parse_table(text, name, rows)
    base, *others = cells.values()
    for row in others:
        for number, column in enumerate(figure.times, len(figure.columns)):
            pairs = [
                (table_row[titles.index(column)], rows[table_row[0]][number]) for table_row in (row, base)
            ]
            try:
                (old, new), (old_base, new_base) = [
                    [float(cell.replace(",", "")) for cell in pair] for pair in pairs
                ]
            except ValueError:  # a cell without a time
                continue
            yield f"{name:<12} {row[0]:<52} {column:<8} {old / old_base:8.2f} {new / new_base:8.2f}"


def list_differences(before: str, after: str, tolerance: float = 0.0) -> Iterator[str]:
    """Yield the lines of a page that other cells change, old and new; numbers by more than a share of the old
    one."""
    for old, new in zip(before.split("\n"), after.split("\n"), strict=True):
        if any(
            not _is_near(*cells, tolerance) for cells in zip_longest(_split(old), _split(new), fillvalue="")
        ):
            yield f"- {old}\n+ {new}"


def _is_near(old: str, new: str, tolerance: float) -> bool:
    try:
        before, after = (float(cell.replace(",", "")) for cell in (old, new))
    except ValueError:
        return old == new
    return abs(after - before) <= tolerance * abs(before) if tolerance else old == new


def main() -> int:
    """Write or check figures, or print ratios; return 1 if checked ones differ."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"{', '.join(TABLES)} (default: all)")
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--check", action="store_true", help="write nothing, and end with 1 if figures differ")
    form.add_argument("--ratios", action="store_true", help="print ratios of times, old and new")
    arguments = parser.parse_args()
    differences: list[str] = []
    for name in arguments.names or TABLES:
        figure = TABLES[name]
        if arguments.ratios and not figure.times:
            continue
        page = ROOT / figure.page
        text, rows = page.read_text(encoding="utf-8"), figure.compute()
        if arguments.ratios:
            print(*list_ratios(text, name, figure, rows), sep="\n")
            continue
        written = replace_cells(text, name, figure.columns, rows)
        differences += list_differences(text, written, figure.tolerance)
        if written != text and not arguments.check:
            page.write_text(written, encoding="utf-8")
    print("\n".join(differences), end="\n" if differences else "")
    return 1 if differences and arguments.check else 0


if __name__ == "__main__":
    sys.exit(main())
