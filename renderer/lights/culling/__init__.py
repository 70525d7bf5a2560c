"""Light culling: which lights reach which cell of a view, decided on the device."""

from renderer.lights.culling.cells import Cell, CellGrid, cell_index
from renderer.lights.culling.grid import CellLists, LightGrid
from renderer.lights.culling.projections import make_grid
from renderer.lights.culling.table import CONE_TESTS, SPHERE_TESTS, ConeTest, SphereTest

__all__ = [
    "CONE_TESTS",
    "SPHERE_TESTS",
    "Cell",
    "CellGrid",
    "CellLists",
    "ConeTest",
    "LightGrid",
    "SphereTest",
    "cell_index",
    "make_grid",
]
