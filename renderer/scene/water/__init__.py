"""Water: pools whose surface waves, stepped on the device where they are drawn.

- `pools`: a pool as data, the simulation, which a `SceneBuilder` takes, and its step on NumPy.
- `kernels`: the same step as one dispatch for all pools that are due, whatever the number of steps.

Small waves on shallow water follow the wave equation: h" = c² ∇²h with c = √(g · depth), here with walls that
reflect. A step is one of the leapfrog scheme on a grid. With damping each wave is the undamped one times
exp(-damping · t / 2). So after some time nothing is left of an earlier state, and what returns to view is as
if it had been seen always.
"""

from renderer.scene.water.water_pools import WaterPool, WaterSimulation

__all__ = ["WaterPool", "WaterSimulation"]
