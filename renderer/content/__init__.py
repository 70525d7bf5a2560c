"""Scene content: generators, model files and built-in shapes, found by name.

scene = load_scene("city:blocks=12,seed=3")
camera = parse_camera("ground", scene, frame=600).with_aspect(16 / 9)
"""

from renderer.content.background import BackgroundLoad as BackgroundLoad
from renderer.content.background import LoadProgress as LoadProgress
from renderer.content.import_options import ImportOptions as ImportOptions
from renderer.content.library import GENERATORS as GENERATORS
from renderer.content.library import change_options as change_options
from renderer.content.library import load_scene as load_scene
from renderer.content.library import parse_camera as parse_camera
from renderer.content.library import parse_camera_path as parse_camera_path
from renderer.content.library import parse_path_frames as parse_path_frames
from renderer.content.limits import ModelLimits as ModelLimits
from renderer.content.models import add_model as add_model
from renderer.content.models import load_model as load_model
from renderer.content.models import save_scene as save_scene
from renderer.content.shapes import BUILT_IN as BUILT_IN
from renderer.content.specs import Generator as Generator
from renderer.content.specs import Option as Option
from renderer.content.textures import IMAGE_SIZE as IMAGE_SIZE
from rhi.errors.exports import list_public as _list_public

__all__ = _list_public(globals())
