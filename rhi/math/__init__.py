"""Matrices, projections, cameras and simple shapes in the conventions of this interface, in float64.

    view_projection = perspective(np.radians(60), width / height) @ look_at((3, 2, 5), (0, 0, 0))

- Matrices are row-major, for column vectors: `matrix @ vector`, as in shaders. A stack of them is (…, 4, 4).
- The world is right-handed with +Y up, a view looks along -Z. Angles are in radians.
- Clip depth is reversed unless `Depth.STANDARD` is asked for: 1 at the near plane, 0 at the far one or at
  infinity.
- Round to float32 last: a uniform does that. Objects far from the world's origin stay exact with the camera
  as origin (`relative_to`, `Camera.relative_view_projection`).
"""

from rhi.errors.exports import list_public as _list_public
from rhi.math.camera import Camera as Camera
from rhi.math.camera import Frustum as Frustum
from rhi.math.camera import FrustumPlane as FrustumPlane
from rhi.math.camera import look_at as look_at
from rhi.math.camera import orbit as orbit
from rhi.math.camera import yaw_pitch_rotation as yaw_pitch_rotation
from rhi.math.projections import Depth as Depth
from rhi.math.projections import Orthographic as Orthographic
from rhi.math.projections import Perspective as Perspective
from rhi.math.projections import Projection as Projection
from rhi.math.projections import distance_at_depth as distance_at_depth
from rhi.math.projections import is_parallel as is_parallel
from rhi.math.projections import orthographic as orthographic
from rhi.math.projections import perspective as perspective
from rhi.math.shapes import make_cube as make_cube
from rhi.math.shapes import make_sphere as make_sphere
from rhi.math.transforms import Floats as Floats
from rhi.math.transforms import is_affine as is_affine
from rhi.math.transforms import multiply as multiply
from rhi.math.transforms import normal_matrices as normal_matrices
from rhi.math.transforms import relative_to as relative_to
from rhi.math.transforms import rotation as rotation
from rhi.math.transforms import scaling as scaling
from rhi.math.transforms import transform_bounds as transform_bounds
from rhi.math.transforms import translation as translation

__all__ = _list_public(globals())
