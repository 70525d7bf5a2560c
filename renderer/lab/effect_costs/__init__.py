"""The cost of each effect: scenes of effect steps, what a step adds to a frame, and that removing it takes
this away."""

from renderer.lab.effect_costs.counting import SIZE as SIZE
from renderer.lab.effect_costs.counting import StepRenderer as StepRenderer
from renderer.lab.effect_costs.counting import compare_frames as compare_frames
from renderer.lab.effect_costs.counting import count_step as count_step
from renderer.lab.effect_costs.counting import remove_step as remove_step
from renderer.lab.effect_costs.effect_steps import EFFECT_STEPS as EFFECT_STEPS
from renderer.lab.effect_costs.effect_steps import EffectStep as EffectStep
from renderer.lab.effect_costs.report import EffectRow as EffectRow
from renderer.lab.effect_costs.report import count_effect_costs as count_effect_costs
from renderer.lab.effect_costs.report import format_added as format_added
from renderer.lab.effect_costs.report import format_removed as format_removed
from renderer.lab.effect_costs.report import list_steps_named as list_steps_named
from renderer.lab.effect_costs.report import time_effect_costs as time_effect_costs
from renderer.lab.effect_costs.timing import time_effect_collection as time_effect_collection
from rhi.errors.exports import list_public as _list_public

__all__ = _list_public(globals())
