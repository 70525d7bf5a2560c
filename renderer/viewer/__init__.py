"""The viewer: a scene in a window or a notebook, with a camera that is moved, and commands that switch what
draws it.

viewer = Viewer(device, scene)
viewer.handle(event)           # of rendercanvas
image = viewer.draw()
"""

from renderer.viewer.display_settings import DisplaySettings
from renderer.viewer.viewer import Viewer

__all__ = ["DisplaySettings", "Viewer"]
