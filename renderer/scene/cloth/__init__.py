"""Cloth: sheets of points that keep their distances, stepped on the device where they are drawn.

- `cloth_grid`: a cloth as data: its points, pins, constraints in batches, room, fabric, and the wind that
  blows on it.
- `reference`: the step on NumPy, for scenes without a device, and what the device is compared with.
- `kernels`, `on_device`: the same step as one dispatch for all cloths that are due, whatever the number of
  steps.
- `cloths`: the simulation, which a `SceneBuilder` takes.

A step is one of the extended position-based dynamics of Macklin, Müller and Chentanez (2016), cut into
sub-steps of constant length in which each constraint is projected once (Macklin et al. 2019, "Small steps in
physics simulation"). Its length doesn't depend on frames. Constraints that share a point are in different
batches, so that those of a batch are projected at once. After them each point is put back into the ball
around its nearest pin that the cloth's length allows (Kim, Chentanez and Müller 2012, "Long range
attachments"), and into the cloth's room, a box. Both are convex and hold the pin, so no wind, no fabric and
no number of steps takes a point out of them: the bounds of a cloth hold at all times, and its speeds are
bounded by them.
"""

from renderer.scene.cloth.cloth_grid import ClothGrid, Fabric, Gust, Wind, make_cloth_grid
from renderer.scene.cloth.cloth_simulation import ClothSimulation

__all__ = ["ClothGrid", "ClothSimulation", "Fabric", "Gust", "Wind", "make_cloth_grid"]
