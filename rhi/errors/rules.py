"""The core's rules: one table, sorted by what they guard.

A rule is an id (stable; tests compare it), a sentence, and a tip. `rhi.validation` holds the checks that
use them.
"""

from __future__ import annotations

from typing import Final

from rhi.errors import Rule

__rhi_internal__ = True

# -- containers ------------------------------------------------------------------------------------------

CONTAINER_CAPACITY: Final = Rule("container-capacity", "a container needs room for at least one element")
CONTAINER_FULL: Final = Rule(
    "container-full", "the container is full", "give it more room, or take out first"
)
CONTAINER_EMPTY: Final = Rule("container-empty", "the container is empty", "look at len() first")

# -- states ----------------------------------------------------------------------------------------------

STATE_VALUE: Final = Rule("state-value", "a state's number is out of range")
STATE_TYPE: Final = Rule(
    "state-type", "not a render state", "states are values such as CullMode.NONE or Viewport(…)"
)
STATE_NOTHING: Final = Rule("state-nothing", "a scope needs at least one state")
STATE_DUPLICATE: Final = Rule(
    "state-duplicate", "a scope sets the same state twice", "nest two scopes if both are meant"
)
STATE_CAPABILITY: Final = Rule(
    "state-capability", "the device has no such state", "ask device.capabilities first"
)

# -- device ----------------------------------------------------------------------------------------------

DEVICE_UNKNOWN: Final = Rule("device-unknown", "no backend has this name", "python -m rhi lists the backends")
DEVICE_DRIVER: Final = Rule("device-driver", "the driver can't be used", "python -m rhi says what is missing")
DEVICE_MEMORY: Final = Rule(
    "device-out-of-memory", "the device has no memory left for this", "destroy what is unused"
)
DEVICE_LOST: Final = Rule("device-lost", "the device was lost", "close it and create a new one")
DEVICE_ANSWER: Final = Rule(
    "device-no-answer", "the device never answered a query", "begin the query again, or create a new device"
)
DEVICE_CLOSED: Final = Rule("device-closed", "the device was closed", "keep the work inside its `with` block")
DEVICE_DEBUG: Final = Rule(
    "device-debug", "the driver reported an error", "this is seen with validation=True only"
)
SHADER_DRIVER: Final = Rule("shader-driver", "the driver refused a program's source")

# -- device: calls ---------------------------------------------------------------------------------------

DEVICE_CAPABILITY: Final = Rule(
    "device-capability", "the device can't do this", "ask device.capabilities first"
)
DEVICE_NOT_RECORDING: Final = Rule(
    "device-not-recording",
    "the device records no commands",
    "create it with record=True, or use the null device",
)
DEVICE_ARGUMENT: Final = Rule("device-argument", "an argument has the wrong type")

# -- resources -------------------------------------------------------------------------------------------

RESOURCE_DESTROYED: Final = Rule(
    "resource-destroyed", "the resource was destroyed", "keep it alive while it is used"
)
RESOURCE_FOREIGN: Final = Rule(
    "resource-foreign", "the resource belongs to another device", "make it with the device that uses it"
)
BUFFER_SIZE: Final = Rule("buffer-size", "a buffer's size is not allowed")
BUFFER_RANGE: Final = Rule("buffer-range", "the range lies outside the buffer")
BUFFER_DTYPE: Final = Rule("buffer-dtype", "the array's dtype is not the buffer's")
BUFFER_OVERLAP: Final = Rule(
    "buffer-overlap", "source and target of a copy overlap", "copy through a third buffer"
)
BUFFER_ALIGNMENT: Final = Rule("buffer-alignment", "the offset or size is not aligned")
TEXTURE_SIZE: Final = Rule("texture-size", "a texture's size is not allowed")
TEXTURE_FORMAT: Final = Rule("texture-format", "the texture's format does not allow this")
TEXTURE_LEVELS: Final = Rule("texture-levels", "the texture has no such level or layer")
TEXTURE_SAMPLES: Final = Rule("texture-samples", "the number of samples is not allowed here")
TEXTURE_DATA: Final = Rule("texture-data", "the array does not fit the texels")
TEXTURE_REGION: Final = Rule("texture-region", "the region lies outside the texture's level")
LAYOUT_MISMATCH: Final = Rule(
    "layout-mismatch",
    "the array's dtype is not the shader's layout",
    "make the array with the struct's own dtype",
)
LOCK_TWICE: Final = Rule(
    "lock-twice", "the resource is already locked", "leave the first lock's `with` block"
)
LOCK_OPEN: Final = Rule(
    "lock-open", "a locked resource can't be used by the device", "leave the lock's `with` block"
)
LOCK_CLOSED: Final = Rule(
    "lock-closed", "the lock is not open", "use the array inside the lock's `with` block only"
)

# -- meshes and programs ---------------------------------------------------------------------------------

MESH_DATA: Final = Rule("mesh-data", "the arrays don't make a mesh")
MESH_INDEX: Final = Rule("mesh-index", "the indices don't fit the vertices")
MESH_RANGE: Final = Rule("mesh-range", "the view lies outside the mesh")
MESH_ATTRIBUTE: Final = Rule("mesh-attribute", "the mesh does not feed the program's vertex stage")
PROGRAM_STAGE: Final = Rule("program-stage", "the program lacks the stage that this call runs")
PROGRAM_OUTPUT: Final = Rule("program-output", "the fragment stage's outputs don't fit the pass's targets")
BINDING_MISSING: Final = Rule("binding-missing", "the program needs a binding that was not given")
BINDING_UNKNOWN: Final = Rule("binding-unknown", "the program has no such binding")
BINDING_TYPE: Final = Rule("binding-type", "the binding is of the wrong type")
BINDING_SIZE: Final = Rule("binding-size", "the bound range is too small or not aligned")

# -- passes and work -------------------------------------------------------------------------------------

PASS_NESTED: Final = Rule(
    "pass-nested", "a render pass is already open", "leave the first pass's `with` block"
)
PASS_OPEN: Final = Rule(
    "pass-open", "this can't be done inside a render pass", "leave the pass's `with` block first"
)
PASS_EMPTY: Final = Rule("pass-empty", "a render pass needs a target")
PASS_TARGET: Final = Rule("pass-target", "the texture can't be this target")
PASS_SIZE: Final = Rule("pass-size", "the targets of a pass differ in size")
PASS_SAMPLES: Final = Rule("pass-samples", "the targets of a pass differ in samples")
PASS_CLEAR: Final = Rule("pass-clear", "the clear values don't fit the targets")
PASS_FEEDBACK: Final = Rule(
    "pass-feedback", "a pass can't read what it writes", "copy the texture, or use two"
)
DRAW_OUTSIDE_PASS: Final = Rule(
    "draw-outside-pass", "a draw needs an open render pass", "put it inside `with device.render_pass(...)`"
)
DRAW_COUNT: Final = Rule("draw-count", "a number of instances is not allowed")
DRAW_ARRAY: Final = Rule("draw-array", "not an array of draws", "use mesh.draws(...), or the dtype rhi.DRAW")
DISPATCH_SIZE: Final = Rule("dispatch-size", "the number of work-groups is not allowed")
INDIRECT_RANGE: Final = Rule("indirect-range", "the indirect arguments lie outside their buffer")
IMMEDIATE_VERTEX: Final = Rule("immediate-vertex", "the vertex does not fit the program's vertex stage")
TRANSIENT_SIZE: Final = Rule(
    "transient-size", "transient memory can't hold this", "end frames with device.present(), or use an own buffer"
)

# -- command buffers -------------------------------------------------------------------------------------

RECORD_STATE: Final = Rule(
    "record-state", "the command buffer is not in the state that this call needs",
    "record inside its `with` block, submit after it",
)  # fmt: skip
RECORD_OPEN: Final = Rule(
    "record-open", "a command buffer ends with something still open", "leave every `with` block inside its own"
)
RECORD_TRANSIENT: Final = Rule(
    "record-transient",
    "transient memory belongs to the frame, or to the command buffer, that it was made in",
    "inside a command buffer take `commands.transient`, or an own buffer",
)

# -- time ------------------------------------------------------------------------------------------------

FENCE_VALUE: Final = Rule(
    "fence-value", "no such fence value was signalled", "wait for a value signal() returned"
)
QUERY_STATE: Final = Rule("query-state", "the query is not in the state that this call needs")
QUERY_NESTED: Final = Rule("query-nested", "another occlusion query is open", "end it first")
QUERY_UNFINISHED: Final = Rule(
    "query-unfinished", "the query has no answer yet", "ask is_finished first, or call wait()"
)
CONDITION_NESTED: Final = Rule(
    "condition-nested", "draws depend on one query at a time", "leave the first condition's `with` block"
)
QUERY_ROWS: Final = Rule("query-rows", "the rows don't fit the draws or the query set")
SCOPE_ORDER: Final = Rule("scope-order", "scopes must be left in the reverse order of entry", "use `with`")
BINDING_NAME: Final = Rule("binding-name", "a binding can't have this name", "rename the shader's field")

# -- commands and the null device ------------------------------------------------------------------------

COMMAND_ARGUMENT: Final = Rule("command-argument", "the command has no such argument")
COMMAND_CLEARED: Final = Rule(
    "command-cleared",
    "what holds at a command is unknown once its stream was cleared",
    "read it before clear()",
)
NULL_SAMPLES: Final = Rule(
    "null-samples", "nothing was rasterised, so the samples that passed are not known",
    "say what is seen: backend.answer_queries(...) or backend.count_samples(...)",
)  # fmt: skip
NULL_ANSWER: Final = Rule("null-answer", "not a number of samples")
