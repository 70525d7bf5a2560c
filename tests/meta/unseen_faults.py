"""Random faults that no test can see, by kind, each with the reason.

A fault is named by its file, the line that it changes and the change, so the list holds while lines move. One whose
line is gone is refused by a test.
"""

from __future__ import annotations

from typing import Final, NamedTuple

COST: Final = "the same results; only time, memory or the number of kernels differs"
SAME: Final = "the same value for all arguments that can occur"
GUARD: Final = "a second guard: another check refuses the same"
WORDS: Final = "the wording of a text for people"
LOOK: Final = "a measure of how something looks, for which another number is as right"
DRIVER: Final = "another driver would show it; the installed ones behave alike"


class Unseen(NamedTuple):
    """A fault that can't be seen: in the line `text` of `file`, `old` becomes `new`. `why` is one of the kinds."""

    file: str
    text: str
    old: str
    new: str
    why: str


UNSEEN: Final[tuple[Unseen, ...]] = (
    Unseen(
        "renderer/scene/lights.py",
        'return show(row) if len(allowed) == 1 else f"{show(row)} in row {row}"', "1", "2",
        f"{WORDS}: the only one of one light is row 0",
    ),
    Unseen(
        "rhi/shading/numpy/kernel.py",
        'space: dict[str, Any] = {"np": np, "R": numpy_runtime, "__rhi_internal__": True}', "True", "False",
        f"{SAME}: nothing that lanes call looks for the user's line",
    ),
    Unseen(
        "rhi/trace/diff.py", "elif isinstance(old, bytes) and isinstance(new, bytes):", "and", "or",
        f"{SAME}: two commands of one kind have bytes in the same places",
    ),
    Unseen(
        "renderer/layers/overlay/overlay.py", "_NAMES: Final = 130  # width of the names of counters", "130", "131",
        f"{LOOK}: the distance of two columns",
    ),
    Unseen(
        "rhi/backends/cl/raster/assembly.py", "self.listed = 0  # indices in the lists that were made for `kept`",
        "0", "1", f"{COST}: lists are made again one index earlier",
    ),
    Unseen(
        "rhi/backends/cl/raster/kernels/raster.cl", "if (COLOR_COUNT && (MAX_SAMPLES == 1 || bits_of(mask)))", "1", "2",
        f"{COST}: colors are merged under a mask, empty or not",
    ),
    Unseen(
        "renderer/frame/resources.py", "self.simulate(self.find_in_view(camera, rows), is_drawn=False)",
        "self.simulate(self.find_in_view(camera, rows), is_drawn=False)", "pass",
        f"{COST}: what is drawn is simulated then, one after the other",
    ),
    Unseen(
        "renderer/frame/resources.py", "return False", "False", "True",
        f"{COST}: all rows of places are compared, and the same ones written",
    ),
    Unseen(
        "renderer/scene/meshes.py",
        "self.vertices: NDArray[Any] = np.concatenate([g.vertices for g in geometries] or [np.empty(0, VERTEX)])",
        "0", "1", f"{SAME}: a scene has an object, and so a mesh",
    ),
    Unseen(
        "renderer/visibility/boxes/hierarchy.py", "self._sort(self.order[np.lexsort((key, self.owner))])",
        "self._sort(self.order[np.lexsort((key, self.owner))])", "pass", f"{COST}: boxes around whatever is in a half",
    ),
    Unseen(
        "renderer/frame/lamps.py", "_GROUP: Final = 64", "64", "65",
        f"{SAME}: groups of another size place the same lamps",
    ),
    Unseen(
        "renderer/visibility/software_depth.py",
        "distance = np.maximum(squared_distances(camera.position, middle, middle), 1e-30)", "1e-30", "2e-30",
        f"{SAME}: no two points are nearer and not in one place",
    ),
    Unseen(
        "rhi/backends/gl/backend.py", "self._tests_alpha = False", "False", "True",
        f"{SAME}: the first program that is bound finds out",
    ),
    Unseen(
        "rhi/backends/cl/raster/kernels/vertex.cl", "const int last = draw->vertices - 1 - part * GROUP;", "*", "/",
        f"{SAME}: nobody uses the lanes beyond the last vertex, and what they fetch is kept within the buffer",
    ),
    Unseen(
        "rhi/backends/cl/raster/boxes.py", "prepared.version += 1", "1", "2",
        f"{SAME}: versions are compared for being equal alone",
    ),
    Unseen(
        "rhi/contract/layout.py", "return place(ArrayType(type, 1), layout).stride", "1", "2",
        f"{SAME}: the stride of an array doesn't depend on its length",
    ),
    Unseen(
        "rhi/contract/states.py", "@dataclass(frozen=True, slots=True, eq=False)", "False", "True",
        f"{SAME}: values are interned, so two whose fields are equal are one object",
    ),
)  # fmt: skip


def explain(file: str, text: str, old: str, new: str) -> str:
    """Return why a fault can't be seen, "" if no reason is known."""
    return next((one.why for one in UNSEEN if one[:4] == (file, text, old, new)), "")
