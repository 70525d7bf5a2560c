"""Screens: images of any device in a window, a Qt widget, a notebook, a browser page, or nowhere.

    with open_screen("gl", title="city", size=(960, 540)) as screen:
        def draw():
            image = renderer.render(screen.size)
            screen.show(image)

        screen.canvas.add_event_handler(on_event, "pointer_move", "key_down")
        screen.run(draw)

- A **canvas** is one of rendercanvas: events, scheduling, sizes and pacing are its contract, so what is
  written for one canvas works on all. `Window` is a canvas of our own; the others are rendercanvas's.
- A **screen** is a canvas with a device whose images it shows. A `gl` device draws beside the window's
  context, and its images are copied on the GPU; images of other devices, and images on other canvases, are
  read back and uploaded once.
- This package uses only rhi's public names. rendercanvas and GLFW are imported when a screen is opened; what
  is missing then is named, with what to install.
"""

from rhi_screen.cameras import FlyCamera, OrbitCamera
from rhi_screen.canvases import CANVASES, open_canvas
from rhi_screen.executors import make_executor
from rhi_screen.films import FilmResult, film
from rhi_screen.gamepads import Gamepad, Gamepads, SimulatedGamepads
from rhi_screen.image_program import save_image
from rhi_screen.monitors import Monitor
from rhi_screen.screen import Screen, open_screen
from rhi_screen.statistics import FrameCounter
from rhi_screen.targets import ScreenTargets
from rhi_screen.time_steps import FixedSteps
from rhi_screen.video import VideoWriter

__all__ = [
    "CANVASES",
    "FilmResult",
    "FixedSteps",
    "FlyCamera",
    "FrameCounter",
    "Gamepad",
    "Gamepads",
    "Monitor",
    "OrbitCamera",
    "Screen",
    "ScreenTargets",
    "SimulatedGamepads",
    "VideoWriter",
    "film",
    "make_executor",
    "open_canvas",
    "open_screen",
    "save_image",
]
