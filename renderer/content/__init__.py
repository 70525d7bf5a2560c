"""Scene content: generators, model files and built-in shapes, found by name.

scene = load_scene("city:blocks=12,seed=3")
camera = parse_camera("ground", scene, frame=600).with_aspect(16 / 9)
"""

from renderer.content.library import GENERATORS, find_path, load_scene, parse_camera
from renderer.content.models import add_model, load_model, save_scene
from renderer.content.shapes import BUILT_IN
from renderer.content.specs import Generator, Option
from renderer.content.textures import IMAGE_SIZE

__all__ = [
    "BUILT_IN",
    "GENERATORS",
    "IMAGE_SIZE",
    "Generator",
    "Option",
    "add_model",
    "find_path",
    "load_model",
    "load_scene",
    "parse_camera",
    "save_scene",
]
