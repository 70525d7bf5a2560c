"""The renderer's rules in one table, ordered by package from the scene upwards.

A rule is an id (stable: tests compare it), a sentence and a tip; `refuse` of `rhi.errors` raises it.
`refuse_name` is the one way to refuse a name: it lists the allowed names and suggests the nearest one.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from difflib import get_close_matches
from enum import Enum
from functools import cache
from math import inf, isfinite
from types import NoneType
from typing import Any, Final, NoReturn, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from rhi.errors import RhiError, Rule, describe_value, refuse
from rhi.errors.arguments import describe_choices, to_integer
from rhi.errors.array_likes import to_real, to_real_array
from rhi.errors.choices import Choice, suggest_members

Value = TypeVar("Value")

_MOST: Final = 2**31 - 1
"""The largest whole number of a setting."""

# Model files
MISSING_FILE: Final = Rule("scene-missing-file", "the model file does not exist")
UNKNOWN_FORMAT: Final = Rule("scene-unknown-format", "the model file's extension names no known format")
UNREADABLE_MODEL: Final = Rule(
    "scene-unreadable-model",
    "the model file can't be read as the format that its extension names",
    "open the file in a viewer, or export it again",
)
BAD_LIMIT: Final = Rule("scene-bad-limit", "a limit of model files is a number of 0 or more, or infinite")
MODEL_LIMIT: Final = Rule(
    "scene-model-limit",
    "the model file exceeds a limit",
    "if you trust it: load_model(..., limits=ModelLimits(...)), or file.gltf:unlimited",
)
FILE_VERSION: Final = Rule(
    "file-version",
    "the file's version isn't known",
    "read it with the version of rhi that wrote it, or a later one",
)
LOAD_CANCELLED: Final = Rule("scene-load-cancelled", "the scene was not loaded, because that was cancelled")
BAD_IMPORT: Final = Rule("scene-bad-import", "an option of a model file is not allowed")
UNKNOWN_PART: Final = Rule("scene-unknown-part", "no node or mesh of the model file has a name like this")
EMPTY_MODEL: Final = Rule(
    "scene-empty-model",
    "the model has nothing to draw",
    "export triangles; points and lines are drawn from glTF files",
)

# Parts of a scene
BAD_VERTICES: Final = Rule(
    "scene-bad-vertices",
    "a mesh needs finite vertices",
    "remove vertices with NaN or infinity, then export again",
)
BAD_MESH: Final = Rule(
    "scene-bad-mesh", "a mesh consists of triangles: three indices each, each of them the index of a vertex"
)
SMALL_BOUNDS: Final = Rule(
    "scene-small-bounds",
    "the declared bounds of a mesh hold all of its vertices",
    "enlarge them, or leave `bounds` out if nothing moves its vertices",
)
BAD_HEIGHTS: Final = Rule(
    "scene-bad-heights",
    "a height field needs finite heights over a rectangle and a maximum number of triangles",
)
SHARED_HEIGHTS: Final = Rule(
    "scene-shared-heights",
    "a height field or a tessellated mesh can belong to only one object",
    "add a mesh for each object: add_height_field, add_tessellated_mesh",
)
BAD_TRANSFORM: Final = Rule(
    "scene-bad-transform", "a transform is a finite, affine 4x4 matrix for column vectors: last row 0 0 0 1"
)
BAD_INDEX: Final = Rule("scene-bad-index", "an id must name something that was added before")
BAD_MATERIAL: Final = Rule("scene-bad-material", "a material's value is out of its range")
BAD_LIGHTING_MODEL: Final = Rule(
    "shader-bad-lighting-model",
    "a lighting model is a function of the shading language: of a SurfacePoint, an Incidence and, if the shader has "
    "any, its parameters, to a vec3",
    "@sl.function, def model(surface: SurfacePoint, light: Incidence, own: MyParameters) -> sl.vec3",
)
BAD_IMAGE: Final = Rule(
    "scene-bad-image",
    "an image is a uint8 array of shape (height, width, 4), or float16 or float32 with finite texels, not empty",
)
BAD_LIGHT: Final = Rule("scene-bad-light", "a light's value is out of its range")
BAD_EFFECT: Final = Rule(
    "scene-bad-effect", "a value of fog, bloom, ambient occlusion or depth of field is out of its range"
)
BAD_ENVIRONMENT: Final = Rule(
    "scene-bad-environment", "an environment's image isn't one, or a value of it is out of its range"
)
BAD_ENVIRONMENT_FILE: Final = Rule("scene-environment-file", "the image of an environment can't be read")
BAD_ENVIRONMENT_SETTINGS: Final = Rule(
    "environment-bad-settings", "a setting of light from environments is out of its range"
)
BAD_BLOOM: Final = Rule("bloom-bad-settings", "a setting of bloom is out of its range")
BAD_OCCLUSION: Final = Rule("occlusion-bad-settings", "a setting of ambient occlusion is out of its range")
BAD_FOCUS: Final = Rule("focus-bad-settings", "a setting of depth of field is out of its range")
BAD_TEMPORAL: Final = Rule("temporal-bad-settings", "a setting of temporal anti-aliasing is out of its range")
TEMPORAL_FILM: Final = Rule(
    "film-temporal",
    "each frame of a film is drawn as if no other had been, so it has no history",
    "draw it with several samples per pixel (--samples), or at a scale of 2, and switch temporal.is_on off",
)
NOT_FINITE: Final = Rule(
    "scene-not-finite",
    "the numbers of a scene, a camera or a time must be finite",
    "look for a division by 0 or a logarithm in the code that computes the value",
)
STATIC_NODE: Final = Rule(
    "scene-static-node",
    "a static node can't be moved",
    "add the node, or one of its ancestors, with dynamic=True",
)
FIXED_PARENT: Final = Rule(
    "scene-fixed-parent",
    "a node animated within bounds keeps its parent, and so do the nodes between it and its objects",
)
FIXED_MESH: Final = Rule(
    "scene-fixed-mesh",
    "a mesh can be replaced only on a dynamic node outside of declared bounds, and only if neither mesh is "
    "simulated or tessellated",
    "give the object a dynamic node that is neither animated within bounds nor below such a node",
)
NO_TANGENTS: Final = Rule(
    "scene-no-tangents",
    "a material with a normal map needs a mesh with tangents",
    "build the scene with an object of this mesh and this material: then the mesh gets them",
)
NO_ROOM: Final = Rule(
    "scene-no-room",
    "all reserved objects are in use",
    "reserve more of them before the scene is built",
)
REMOVED_OBJECT: Final = Rule("scene-removed-object", "a handle of an object that was removed names nothing")
SHARED_MESH: Final = Rule(
    "scene-shared-mesh",
    "a simulated object needs a simulation and a mesh of its own",
    "add a mesh for each member",
)
UNBOUNDED_MESH: Final = Rule(
    "scene-unbounded-mesh",
    "the mesh of a simulated object needs bounds that hold at all times",
    "pass add_mesh(bounds=...): hidden objects aren't stepped, so their bounds must be known in advance",
)
SHARED_NODE: Final = Rule("scene-shared-node", "a node has at most one animation")
BAD_DECAL: Final = Rule(
    "scene-bad-decal", "a number of a decal is out of its range, or its image is too bright"
)
SHARED_LIGHT: Final = Rule("scene-shared-light", "a light is at one node, or at none")
UNKNOWN_LIGHT_KIND: Final = Rule("scene-unknown-light-kind", "no lights have an array of this name")
BAD_SIMULATION: Final = Rule(
    "scene-bad-simulation",
    "a simulation needs a catch-up policy, the methods that the policy calls, and a method for its result",
)
BAD_BEHAVIOR: Final = Rule(
    "scene-bad-behavior", "a behaviour is a function of an entity and a step, and moves nodes of its own"
)
UNKNOWN_ENTITY: Final = Rule(
    "scene-unknown-entity", "no entity has this number", "it may have been removed: ask `number in behaviors`"
)
BAD_CLIP: Final = Rule(
    "scene-bad-clip", "the weight of a clip and the length of a fade must be finite and at least 0"
)
LEFT_BOUNDS: Final = Rule(
    "scene-left-bounds",
    "a simulated object left the bounds that were declared to hold at all times",
    "declare larger bounds: an object outside its bounds may be culled while it is visible",
)
BAD_CLOTH: Final = Rule(
    "scene-bad-cloth",
    "a cloth needs a grid of distinct points, some of them pinned, and a wind of finite speed",
)
BAD_WATER: Final = Rule(
    "scene-bad-water",
    "a pool needs a grid of points, and shallow water whose waves cross at most one cell per step",
)
BAD_PARTICLES: Final = Rule(
    "scene-bad-particles",
    "an emitter needs at least one particle, and finite numbers in range",
)
UNKNOWN_NODE: Final = Rule("scene-unknown-node", "no node has this name")

# Scene text
UNKNOWN_SCENE: Final = Rule(
    "scene-unknown-scene", "the text names neither a scene generator nor a model file"
)
SPEC_SYNTAX: Final = Rule("scene-spec-syntax", "the options of a scene are written name:key=value,key=value")
UNKNOWN_KEY: Final = Rule("scene-unknown-key", "the scene has no option of this name")
BAD_VALUE: Final = Rule("scene-bad-value", "the value of a scene's option is not allowed")

# Cameras
UNKNOWN_CAMERA: Final = Rule(
    "camera-unknown-name",
    "the text names no camera of the scene",
    "give a name, a position x,y,z, or a position and a target x,y,z,x,y,z",
)
BAD_PATH: Final = Rule(
    "camera-bad-route", "a camera path has positions and targets of finite numbers, one of each for a frame"
)
BAD_CAMERA_PATH: Final = Rule(
    "camera-bad-path", "the file is not a walk-through", "CameraPath.record(cameras).save(path) writes one"
)
FRAME_RANGE: Final = Rule("camera-frame-range", "the camera path has no such frame")

BAD_STEREO: Final = Rule("stereo-bad-value", "a value of a pair of eyes is out of its range")
NO_STEREO: Final = Rule(
    "stereo-one-eye", "a single eye has no eye distance", "add --stereo dubois, or another output"
)
UNKNOWN_STEREO: Final = Rule("stereo-unknown-output", "there is no stereo output of this name")

# Visibility
BAD_BOUNDS: Final = Rule(
    "visibility-bad-bounds", "bounds must be finite arrays of shape (n, 3), with lower <= upper"
)
UNKNOWN_ALGORITHM: Final = Rule("visibility-unknown-name", "no visibility algorithm has this name")
CANNOT_RUN: Final = Rule(
    "visibility-cannot-run",
    "the device can't run this visibility algorithm",
    "choose another algorithm, or another device: --backend gl or cl",
)
NO_CONDITIONAL_RENDERING: Final = Rule(
    "visibility-no-conditional-rendering",
    "conditional culling needs a device with conditional rendering and native occlusion queries",
    "chc_plus_plus needs only occlusion queries",
)
NO_COMPUTE: Final = Rule(
    "visibility-no-compute",
    "culling on the device needs compute shaders and draws",
    "frustum culling needs neither",
)
NO_RENDERER: Final = Rule(
    "visibility-no-renderer",
    "the algorithm needs the buffers or the depth of a renderer's pass",
    "give it to a Renderer as its `visibility`; `result.visible` are the rows that it drew",
)
STALE_LIST: Final = Rule(
    "visibility-stale-list",
    "a list of draws made on the device can be read only until the next frame replaces it",
    "read `result.visible` and `result.statistics` before the next frame",
)
BAD_PARAMETER: Final = Rule(
    "visibility-bad-parameter", "a visibility algorithm's parameter is out of its range"
)
BAD_SETTINGS: Final = Rule(
    "visibility-bad-settings",
    "the file holds no settings of visibility algorithms",
    "python -m renderer tune writes one",
)

# Light culling
BAD_GRID: Final = Rule("lights-bad-grid", "a view can't be divided into cells like this")
UNKNOWN_LIGHT_TEST: Final = Rule("lights-unknown-test", "no test of light culling has this name")

# A frame's plan
TWO_WRITERS: Final = Rule(
    "plan-two-writers",
    "a resource of a frame may be written by only one pass",
    "give the result of the second pass a name of its own: changes={old: new}",
)
DRAWN_OVER_TWICE: Final = Rule(
    "plan-drawn-over-twice",
    "a resource of a frame may be drawn over by only one pass",
    "make the second pass draw over the first pass's result",
)
UNWRITTEN: Final = Rule("plan-unwritten", "a resource that a pass or the frame needs is written by no pass")
UNKNOWN_RESOURCE: Final = Rule("plan-unknown-resource", "the frame's plan has no texture of this name")
PLAN_CYCLE: Final = Rule("plan-cycle", "the passes of a frame depend on each other in a cycle")

# Techniques
ONE_SAMPLE: Final = Rule(
    "technique-one-sample",
    "this technique draws one sample per pixel",
    "smooth its image with --fxaa, or use --technique forward, light_indexed, forward_plus, clustered, "
    "tiled_deferred, clustered_deferred or deferred_plus. The others add light up in textures of one sample, and a "
    "shader can't tell which sample it is run for",
)
TOO_MANY_MATERIALS: Final = Rule(
    "technique-too-many-materials",
    "a packed geometry buffer holds 16 bits of a pixel's material",
    "use --technique clustered",
)
MISSING_BINDING: Final = Rule(
    "technique-missing-binding",
    "a shader binds a name that its frame doesn't provide",
    "pass values that only this shader uses with the draw (shader_bindings={name: ...}), or add it to `FrameBindings`",
)
NO_WIREFRAME: Final = Rule(
    "technique-no-wireframe", "a wireframe needs a device that draws the edges of triangles"
)
BAD_STEP: Final = Rule("animation-step", "the step of animations, in seconds, is out of its range")
BAD_TIME: Final = Rule(
    "animation-time",
    "the time of a frame must be a number of seconds small enough to count its steps",
    "measure time from the start of the program, or take it modulo the animation's length",
)
BAD_LAG: Final = Rule("animation-lag", "the lag allowed for small objects, in pixels, is out of its range")
BAD_CUTOFF: Final = Rule("light-cutoff", "the cut-off of local lights is out of its range")
BAD_DETAIL: Final = Rule("detail-error", "the largest error of levels of detail is out of its range")
BAD_SCALE: Final = Rule("render-scale", "the render scale is out of its range")
BAD_EDGE: Final = Rule("tessellation-edge", "the edge length of tessellation, in pixels, is out of its range")
BAD_TECHNIQUE: Final = Rule("technique-parameter", "a parameter of a technique is out of its range")

# Settings
BAD_RENDER_SETTING: Final = Rule(
    "renderer-settings", "a setting of the renderer has a value of the wrong type"
)
BAD_ATTRIBUTE: Final = Rule("renderer-attribute", "a renderer's argument or attribute is of the wrong type")
BAD_UPLOADS: Final = Rule("upload-settings", "a setting of uploads is out of its range")
BAD_TEXTURES: Final = Rule("texture-settings", "a setting of textures is out of its range")

# Shadows
BAD_SHADOWS: Final = Rule("shadow-settings", "a setting of shadow maps is out of its range")

# The canvas
FONT_FILE: Final = Rule("canvas-font-file", "the file can't be read as a font")
FONT_SIZE: Final = Rule("canvas-font-size", "a font's size is out of its range")

# The viewer
UNKNOWN_COMMAND: Final = Rule(
    "viewer-unknown-command", "the viewer has no command of this name", "`help` lists them all"
)
BAD_ARGUMENT: Final = Rule(
    "viewer-bad-argument", "a command doesn't accept this argument", "Tab in the console lists them"
)
NO_SCREENSHOT: Final = Rule(
    "viewer-no-screenshot",
    "the device draws nothing, so there is no image",
    "choose another one: --backend gl or cl",
)
CANNOT_LISTEN: Final = Rule("viewer-cannot-listen", "can't listen on this port", "choose another one")

# Measurements

NO_IMAGES: Final = Rule("measure-no-images", "the textured pass needs a scene with images")
TOO_FEW_LIGHTS: Final = Rule(
    "measure-too-few-lights", "the scene has fewer point and spot lights than the comparison needs"
)
FIXED_SCENE: Final = Rule(
    "measure-fixed-scene",
    "a scene without an option for it can't be compared with another number of objects or lights",
    "leave out --objects or --lights: the scene is compared as it is",
)
UNKNOWN_QUALITY_SETTING: Final = Rule(
    "accuracy-unknown-setting", "no choice between accuracy and time has this name"
)
OUT_OF_REACH: Final = Rule(
    "accuracy-out-of-reach", "none of the settings tried is that fast and that accurate"
)
OTHER_SETTINGS: Final = Rule(
    "accuracy-other-settings", "settings in use are values of other quality settings than those to choose"
)
NO_QUALITY_SETTINGS: Final = Rule(
    "accuracy-no-settings", "none of these quality settings matters for this scene and device"
)
UNKNOWN_CASE: Final = Rule("exam-unknown-case", "the exam has no case of this number")
NO_RENDERING: Final = Rule("measure-no-rendering", "a backend that draws no images has no passes to time")
NO_SHADERS: Final = Rule("measure-no-shaders", "a device that runs no shaders stores no values")


def describe(error: RhiError) -> str:
    """Return an error as one line: what is wrong, what was given, what is allowed, a tip and the rule."""
    allowed = f" (allowed: {error.allowed})" if error.allowed else ""
    value = f": {error.given}" if error.given else ""
    tip = f"; {error.tip}" if error.tip else ""
    line = f"{error.rule.sentence.rstrip('.')}{value}{allowed}{tip} [{error.rule.id}]"
    return " ".join(line.split())


def describe_missing(module: str | None, extra: str) -> str:
    """Return the line that says how to install a module that an extra brings, by name and from a checkout."""
    return (
        f"{module} is missing; install it with: pip install 'rhi[{extra}]', "
        f"or in a checkout: pip install --editable '.[{extra}]'"
    )


def refuse_name(rule: Rule, call: str, name: str, allowed: Iterable[str]) -> NoReturn:
    """Refuse `name`, listing the `allowed` names and suggesting the nearest one, if any is similar."""
    names = list(allowed)
    near = get_close_matches(name.lower(), names, n=1)
    refuse(rule, call, name, ", ".join(names), f"did you mean {near[0]!r}?" if near else "")


def check_non_negative(rule: Rule, call: str, value: float) -> None:
    """Refuse a number that isn't 0 or more, and finite."""
    number = _as_float(value)
    if number is None or not 0.0 <= number < inf:
        refuse(rule, call, describe_value(value), "0 or more, finite")


def check_scale(call: str, value: float) -> None:
    """Refuse an image scale that one bilinear sample couldn't resize to the frame's size."""
    number = _as_float(value)
    if number is None or not 0.1 <= number <= 2.0:
        refuse(BAD_SCALE, call, describe_value(value), "0.1 to 2")


def check_type(call: str, value: Any, kind: type[Value]) -> Value:
    """Return a value of `kind`, and refuse any other. The name of an enum's member is refused with the
    member."""
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIOU" else "a"
        tip = suggest_members(value, kind) if isinstance(value, str) and issubclass(kind, Choice) else ""
        refuse(BAD_ATTRIBUTE, call, describe_value(value), f"{article} {kind.__name__}", tip)
    return value


def refuse_object(call: str, value: object, allowed: str) -> NoReturn:
    """Refuse an object that isn't `allowed`; of a class say how to create one."""
    tip = f"{value.__name__} is the class; create one: {value.__name__}(…)" if isinstance(value, type) else ""
    refuse(BAD_ATTRIBUTE, call, describe_value(value), allowed, tip)


def check_types(settings: Any, rule: Rule) -> None:
    """Refuse a dataclass with a value of another type than its field's, or a whole number beyond 32 bits.

    NumPy's numbers become Python's, and sequences of numbers become tuples of floats. NaN is refused by the
    field's range.
    """
    owner: type = type(settings)
    for name, kinds in _list_types(owner):
        value = getattr(settings, name)
        if value.__class__ is kinds[0] and kinds[0] in (bool, str):
            continue
        for kind in kinds:
            number = _as_kind(value, kind)
            if number is not None or (kind is NoneType and value is None):
                break
        else:
            allowed = " or ".join(_describe_type(kind) for kind in kinds)
            refuse(rule, f"{owner.__name__}({name}=...)", describe_value(value), allowed)
        if number is not None and type(value) not in (int, float) and number is not value:
            object.__setattr__(settings, name, number)


def check_count(rule: Rule, call: str, value: Any, least: int = 1) -> int:
    """Return a whole number as an int, and refuse anything else, fewer than `least`, or more than 32 bits
    hold."""
    number = to_integer(value)
    if number is None or not least <= number <= _MOST:
        refuse(rule, call, describe_value(value), f"a whole number of {least} or more, up to {_MOST:,}")
    return number


def check_numbers(rule: Rule, call: str, **values: Any) -> tuple[float, ...]:
    """Return finite real numbers as floats, and refuse anything else."""
    numbers = []
    for name, value in values.items():
        number = _as_float(value)
        if number is None or not isfinite(number):
            refuse(rule, f"{call}({name}=...)", describe_value(value), "a finite number")
        numbers.append(number)
    return tuple(numbers)


@cache
def _list_types(owner: type) -> tuple[tuple[str, tuple[Any, ...]], ...]:
    """Return the fields of a dataclass, each with the types that its value may have."""
    hints = get_type_hints(owner)
    kinds = ((field.name, hints[field.name]) for field in fields(owner))
    return tuple(
        (name, (kind,) if get_origin(kind) is tuple else get_args(kind) or (kind,)) for name, kind in kinds
    )


def _as_kind(value: Any, kind: Any) -> Any:
    """Return a value as a field of a type holds it, None if it isn't of that type."""
    if kind is int:
        number = to_integer(value)
        return number if number is not None and abs(number) <= _MOST else None
    if kind is float:
        return _as_float(value)
    if get_origin(kind) is tuple:
        return _as_floats(value, len(get_args(kind)))
    return value if isinstance(value, kind) else None


def _as_float(value: Any) -> float | None:
    """Return a real number, also NaN, as an int or a float; None for anything else, bools too."""
    if value.__class__ is float:
        return value
    if isinstance(value, bool | np.bool_):
        return None
    try:
        number = float(to_real(value))
    except (TypeError, ValueError, OverflowError):
        return None
    return value if value.__class__ is int else number


def _as_floats(value: Any, count: int) -> tuple[float, ...] | None:
    """Return finite numbers of this count as floats, None for anything else."""
    if value.__class__ is tuple and len(value) == count and all(v.__class__ is float for v in value):
        return value if all(map(isfinite, value)) else None
    try:
        numbers = np.asarray(to_real_array(value), np.float64)
    except (TypeError, ValueError, OverflowError):
        return None
    if numbers.shape != (count,) or not np.isfinite(numbers).all():
        return None
    return tuple(numbers.tolist())


def _describe_type(kind: Any) -> str:
    if get_origin(kind) is tuple:
        return f"{len(get_args(kind))} finite numbers"
    words = {
        bool: "True or False",
        int: f"a whole number up to {_MOST:,}",
        float: "a number",
        str: "a text",
        NoneType: "None",
    }
    return describe_choices(kind) if issubclass(kind, Enum) else words.get(kind, f"a {kind.__name__}")
