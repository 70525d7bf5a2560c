"""A frame: the scene on a device, its views, the plan of its passes, and the textures that they draw to."""

from renderer.frame.frame import Frame as Frame
from renderer.frame.images import AS_GIVEN as AS_GIVEN
from renderer.frame.images import TextureSettings as TextureSettings
from renderer.frame.layer import Layer as Layer
from renderer.frame.layer import SceneLayer as SceneLayer
from renderer.frame.mirrors import MirroredArray as MirroredArray
from renderer.frame.needs import EXACT_GLOW as EXACT_GLOW
from renderer.frame.needs import LAMPS as LAMPS
from renderer.frame.needs import LIGHT_FORMATS as LIGHT_FORMATS
from renderer.frame.needs import SHADOW_EFFECTS as SHADOW_EFFECTS
from renderer.frame.needs import Blending as Blending
from renderer.frame.needs import Effect as Effect
from renderer.frame.needs import GlowSettings as GlowSettings
from renderer.frame.needs import Needs as Needs
from renderer.frame.needs import find_needs as find_needs
from renderer.frame.passes import BoundProgram as BoundProgram
from renderer.frame.passes import Drawn as Drawn
from renderer.frame.passes import TechniquePass as TechniquePass
from renderer.frame.passes import choose_program as choose_program
from renderer.frame.plan import OUTPUTS as OUTPUTS
from renderer.frame.plan import DroppedPass as DroppedPass
from renderer.frame.plan import Pass as Pass
from renderer.frame.plan import Plan as Plan
from renderer.frame.plan import SharedTexture as SharedTexture
from renderer.frame.plan import Target as Target
from renderer.frame.plan import find_last as find_last
from renderer.frame.plan import make_plan as make_plan
from renderer.frame.resources import SceneResources as SceneResources
from renderer.frame.resources import find_states as find_states
from renderer.frame.seen import SeenFeatures as SeenFeatures
from renderer.frame.targets import DEPTH_FORMAT as DEPTH_FORMAT
from renderer.frame.targets import IMAGE_FORMAT as IMAGE_FORMAT
from renderer.frame.targets import Targets as Targets
from renderer.frame.view import View as View
from rhi.errors.exports import list_public as _list_public

__all__ = _list_public(globals())
