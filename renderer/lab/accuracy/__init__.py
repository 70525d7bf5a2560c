"""The cost of accuracy in time: quality settings, the error and the time of their values, and the choice
between them."""

from renderer.lab.accuracy.bench import TRACED_PIXELS as TRACED_PIXELS
from renderer.lab.accuracy.bench import keep_references as keep_references
from renderer.lab.accuracy.choice import FRONT_PIXELS as FRONT_PIXELS
from renderer.lab.accuracy.choice import CheckedChoice as CheckedChoice
from renderer.lab.accuracy.choice import ParetoPoint as ParetoPoint
from renderer.lab.accuracy.choice import choose as choose
from renderer.lab.accuracy.choice import compute_pareto_front as compute_pareto_front
from renderer.lab.accuracy.choice import leave_to_trials as leave_to_trials
from renderer.lab.accuracy.choice import select_effective_reports as select_effective_reports
from renderer.lab.accuracy.jobs import SweepJob as SweepJob
from renderer.lab.accuracy.jobs import list_jobs as list_jobs
from renderer.lab.accuracy.jobs import load_or_compute_pareto_front as load_or_compute_pareto_front
from renderer.lab.accuracy.jobs import run_jobs as run_jobs
from renderer.lab.accuracy.quality_settings import NOT_QUALITY_SETTINGS as NOT_QUALITY_SETTINGS
from renderer.lab.accuracy.quality_settings import QUALITY_SETTINGS as QUALITY_SETTINGS
from renderer.lab.accuracy.quality_settings import ErrorUnit as ErrorUnit
from renderer.lab.accuracy.quality_settings import QualitySetting as QualitySetting
from renderer.lab.accuracy.quality_settings import Reference as Reference
from renderer.lab.accuracy.quality_settings import Requirement as Requirement
from renderer.lab.accuracy.quality_settings import lookup_quality_setting as lookup_quality_setting
from renderer.lab.accuracy.sweep import FLICKER_WEIGHT as FLICKER_WEIGHT
from renderer.lab.accuracy.sweep import SettingReport as SettingReport
from renderer.lab.accuracy.sweep import SweepSetup as SweepSetup
from renderer.lab.accuracy.sweep import ValueRow as ValueRow
from renderer.lab.accuracy.sweep import sweep_setting as sweep_setting
from rhi.errors.exports import list_public as _list_public

__all__ = _list_public(globals())
