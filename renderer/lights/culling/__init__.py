"""Light culling: which lights reach which cell of a view, decided on the device."""

from renderer.lights.culling.cells import Cell as Cell
from renderer.lights.culling.cells import CellGrid as CellGrid
from renderer.lights.culling.cells import cell_index as cell_index
from renderer.lights.culling.grid import CellLists as CellLists
from renderer.lights.culling.grid import LightGrid as LightGrid
from renderer.lights.culling.projections import make_grid as make_grid
from renderer.lights.culling.table import CONE_TESTS as CONE_TESTS
from renderer.lights.culling.table import SPHERE_TESTS as SPHERE_TESTS
from renderer.lights.culling.table import ConeTest as ConeTest
from renderer.lights.culling.table import SphereTest as SphereTest
from rhi.errors.exports import list_public as _list_public

__all__ = _list_public(globals())
