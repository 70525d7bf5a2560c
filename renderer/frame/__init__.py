"""A frame: the scene on a device, its views, the plan of its passes, and the textures that they draw to."""

from renderer.frame.drawing import BoundProgram as BoundProgram
from renderer.frame.drawing import DrawResult as DrawResult
from renderer.frame.drawing import TechniqueDrawer as TechniqueDrawer
from renderer.frame.drawing import choose_program as choose_program
from renderer.frame.effects import EXACT_BLOOM as EXACT_BLOOM
from renderer.frame.effects import LIGHT_FORMATS as LIGHT_FORMATS
from renderer.frame.effects import LOCAL_LIGHTS as LOCAL_LIGHTS
from renderer.frame.effects import PENUMBRA_EFFECTS as PENUMBRA_EFFECTS
from renderer.frame.effects import SHADOW_EFFECTS as SHADOW_EFFECTS
from renderer.frame.effects import Blending as Blending
from renderer.frame.effects import BloomSettings as BloomSettings
from renderer.frame.effects import Effect as Effect
from renderer.frame.effects import FrameEffects as FrameEffects
from renderer.frame.effects import LightWatch as LightWatch
from renderer.frame.effects import are_effects_same as are_effects_same
from renderer.frame.effects import collect_frame_effects as collect_frame_effects
from renderer.frame.effects import watch_lights as watch_lights
from renderer.frame.frame import Frame as Frame
from renderer.frame.layer import Layer as Layer
from renderer.frame.layer import SceneLayer as SceneLayer
from renderer.frame.mirrors import MirroredArray as MirroredArray
from renderer.frame.occlusion import DEFAULT_OCCLUSION as DEFAULT_OCCLUSION
from renderer.frame.occlusion import OCCLUSION as OCCLUSION
from renderer.frame.occlusion import OcclusionSettings as OcclusionSettings
from renderer.frame.plan import OUTPUTS as OUTPUTS
from renderer.frame.plan import DroppedPass as DroppedPass
from renderer.frame.plan import FramePass as FramePass
from renderer.frame.plan import Plan as Plan
from renderer.frame.plan import SharedTexture as SharedTexture
from renderer.frame.plan import Target as Target
from renderer.frame.plan import last_version as last_version
from renderer.frame.plan import make_plan as make_plan
from renderer.frame.resources import SceneResources as SceneResources
from renderer.frame.resources import draw_group_states as draw_group_states
from renderer.frame.scene_images import SAMPLER_DEFAULTS as SAMPLER_DEFAULTS
from renderer.frame.scene_images import TextureSettings as TextureSettings
from renderer.frame.targets import DEPTH_FORMAT as DEPTH_FORMAT
from renderer.frame.targets import IMAGE_FORMAT as IMAGE_FORMAT
from renderer.frame.targets import Targets as Targets
from renderer.frame.view import View as View
from renderer.frame.visible_features import VisibleFeatures as VisibleFeatures
from rhi.errors.exports import list_public as _list_public

__all__ = _list_public(globals())
