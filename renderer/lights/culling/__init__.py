"""Light culling: lists of the local lights that reach each cell of a view, made on the device."""

from renderer.lights.culling.cells import Cell as Cell
from renderer.lights.culling.cells import ClusterGrid as ClusterGrid
from renderer.lights.culling.cells import cell_index as cell_index
from renderer.lights.culling.grid_projection import make_grid as make_grid
from renderer.lights.culling.light_lists import LightListData as LightListData
from renderer.lights.culling.light_lists import LightLists as LightLists
from renderer.lights.culling.table import CONE_TESTS as CONE_TESTS
from renderer.lights.culling.table import SPHERE_TESTS as SPHERE_TESTS
from renderer.lights.culling.table import ConeTest as ConeTest
from renderer.lights.culling.table import SphereTest as SphereTest
from rhi.errors.exports import list_public as _list_public

__all__ = _list_public(globals())
