"""The rules of the interface, sorted by what they protect.

A rule is an id (stable; tests compare it), a sentence, and a tip. The modules that validate a call refer to
its rule by the constant's name.
"""

from __future__ import annotations

from typing import Final

from rhi.errors import Rule

# -- containers ------------------------------------------------------------------------------------------

CONTAINER_CAPACITY: Final = Rule("container-capacity", "a container needs a capacity of at least one element")
CONTAINER_FULL: Final = Rule(
    "container-full", "the container is full", "make it larger, or remove an element first"
)
CONTAINER_EMPTY: Final = Rule("container-empty", "the container is empty", "check len() first")

# -- states ----------------------------------------------------------------------------------------------

STATE_VALUE: Final = Rule("state-value", "the value of a state is out of range")
STATE_TYPE: Final = Rule(
    "state-type", "not a render state", "states are values such as CullMode.NONE or Viewport(…)"
)
STATE_DUPLICATE: Final = Rule(
    "state-duplicate", "a scope sets the same state twice", "nest two scopes to set it twice"
)
STATE_CAPABILITY: Final = Rule(
    "state-capability", "the device doesn't support this state", "check device.capabilities first"
)
PLATFORM_STATE: Final = Rule(
    "platform-state",
    "the device's platform doesn't have this state",
    "use it only where capabilities.platform_states names its type",
)

# -- device ----------------------------------------------------------------------------------------------

DEVICE_UNKNOWN: Final = Rule("device-unknown", "no backend has this name", "python -m rhi lists the backends")
DEVICE_DRIVER: Final = Rule(
    "device-driver", "the driver can't be used", "python -m rhi reports what is missing"
)
DEVICE_MEMORY: Final = Rule(
    "device-out-of-memory", "the device is out of memory", "destroy resources that are no longer used"
)
DEVICE_LOST: Final = Rule("device-lost", "the device was lost", "close it and create a new one")
DEVICE_WAIT: Final = Rule(
    "device-wait",
    "Python can't wait for this page",
    "await texture.read_async(), buffer.read_async() or device.finish_async()",
)
DEVICE_ANSWER: Final = Rule(
    "device-no-answer",
    "the device never returned the result of a query",
    "repeat the query, or create a new device",
)
DEVICE_CLOSED: Final = Rule("device-closed", "the device was closed", "use it inside its `with` block only")
DEVICE_COPY: Final = Rule(
    "device-copy",
    "an object that belongs to a device can't be copied or pickled",
    "read its contents and create a new object from them; another process must create its own device",
)
RELOAD_WATCH: Final = Rule("reload-watch", "this can't be watched for changes")
DEVICE_DEBUG: Final = Rule(
    "device-debug", "the driver reported an error", "such errors are reported with validation=True only"
)
DEVICE_THREAD: Final = Rule(
    "device-thread",
    "the device belongs to another thread",
    "let that thread do it, or move the device: release_current() there, then make_current() here",
)
DEVICE_FORKED: Final = Rule(
    "device-forked",
    "a device can't be used after its process has forked",
    'start processes by multiprocessing.get_context("spawn"), and create devices there',
)
DEVICE_CONTEXT: Final = Rule(
    "device-context",
    "the device's context is not current on this thread",
    "call device.make_current() after code that makes another context current",
)
SHADER_DRIVER: Final = Rule("shader-driver", "the driver refused a program's source")

# -- device: calls ---------------------------------------------------------------------------------------

DEVICE_CAPABILITY: Final = Rule(
    "device-capability", "the device lacks this capability", "check device.capabilities first"
)
DEVICE_NOT_RECORDING: Final = Rule(
    "device-not-recording",
    "the device doesn't record commands",
    "create it with record=True, or use the null device",
)
DEVICE_ARGUMENT: Final = Rule("device-argument", "an argument has the wrong type")

# -- resources -------------------------------------------------------------------------------------------

RESOURCE_DESTROYED: Final = Rule(
    "resource-destroyed", "the resource was destroyed", "destroy it after its last use"
)
RESOURCE_FOREIGN: Final = Rule(
    "resource-foreign", "the resource belongs to another device", "create it with the device that uses it"
)
BUFFER_SIZE: Final = Rule(
    "buffer-size",
    "a buffer's size is not allowed",
    "no buffer is empty: keep room for one element, and draw 0 instances",
)
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
    "create the array with the struct's own dtype",
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

MESH_DATA: Final = Rule("mesh-data", "the arrays don't form a mesh")
MESH_INDEX: Final = Rule("mesh-index", "the indices don't fit the vertices")
MESH_RANGE: Final = Rule("mesh-range", "the view or draw lies outside the mesh")
MESH_ATTRIBUTE: Final = Rule(
    "mesh-attribute", "the mesh doesn't provide the inputs of the program's vertex stage"
)
PROGRAM_STAGE: Final = Rule("program-stage", "the program lacks the stage that this call executes")
PROGRAM_OUTPUT: Final = Rule(
    "program-output", "the outputs of the fragment stage don't match the targets of the pass"
)
BINDING_MISSING: Final = Rule("binding-missing", "a binding of the program is missing")
BINDING_UNKNOWN: Final = Rule("binding-unknown", "the program has no such binding")
BINDING_TYPE: Final = Rule("binding-type", "the binding has the wrong type")
BINDING_SIZE: Final = Rule("binding-size", "the bound range is too small or not aligned")

# -- passes and work -------------------------------------------------------------------------------------

PASS_NESTED: Final = Rule(
    "pass-nested", "a render pass is already open", "leave the first pass's `with` block"
)
PASS_OPEN: Final = Rule(
    "pass-open", "this can't be done inside a render pass", "leave the pass's `with` block first"
)
PASS_EMPTY: Final = Rule("pass-empty", "a render pass needs a target")
PASS_TARGET: Final = Rule("pass-target", "the texture can't be used as this target")
PASS_SIZE: Final = Rule("pass-size", "the targets of a pass differ in size")
PASS_SAMPLES: Final = Rule("pass-samples", "the targets of a pass differ in samples")
PASS_CLEAR: Final = Rule("pass-clear", "the clear values don't match the targets")
PASS_FEEDBACK: Final = Rule(
    "pass-feedback", "a pass can't read a texture that it writes", "copy the texture, or use two textures"
)
DRAW_OUTSIDE_PASS: Final = Rule(
    "draw-outside-pass", "a draw needs an open render pass", "put it inside `with device.render_pass(...)`"
)
DRAW_COUNT: Final = Rule("draw-count", "this number of instances is not allowed")
DRAW_ARRAY: Final = Rule("draw-array", "not an array of draws", "use mesh.draws(...), or the dtype rhi.DRAW")
DISPATCH_SIZE: Final = Rule("dispatch-size", "the number of work-groups is not allowed")
INDIRECT_RANGE: Final = Rule("indirect-range", "the indirect arguments lie outside their buffer")
IMMEDIATE_VERTEX: Final = Rule(
    "immediate-vertex", "the vertex doesn't match the inputs of the program's vertex stage"
)
TRANSIENT_SIZE: Final = Rule(
    "transient-size",
    "transient memory is too small for this",
    "end each frame with device.present(), or use a buffer",
)

# -- command buffers -------------------------------------------------------------------------------------

RECORD_STATE: Final = Rule(
    "record-state",
    "the command buffer is not in the state that this call needs",
    "record inside its `with` block and submit after it",
)
RECORD_OPEN: Final = Rule(
    "record-open",
    "a command buffer ended while a scope was open",
    "end every `with` block inside the command buffer's own",
)
RECORD_TRANSIENT: Final = Rule(
    "record-transient",
    "transient memory belongs to the frame or command buffer in which it was allocated",
    "inside a command buffer use `commands.transient`, or a buffer",
)

# -- time ------------------------------------------------------------------------------------------------

FENCE_VALUE: Final = Rule(
    "fence-value", "this fence value was never signalled", "wait for a value that signal() returned"
)
QUERY_STATE: Final = Rule("query-state", "the query is not in the state that this call needs")
QUERY_NESTED: Final = Rule("query-nested", "another occlusion query is open", "end it first")
QUERY_UNFINISHED: Final = Rule(
    "query-unfinished",
    "the result of the query isn't available yet",
    "check is_finished first, or call wait()",
)
CONDITION_NESTED: Final = Rule(
    "condition-nested",
    "draws can depend on only one query at a time",
    "leave the first condition's `with` block",
)
QUERY_INDICES: Final = Rule("query-indices", "the query indices don't match the draws or the query set")
SCOPE_ORDER: Final = Rule("scope-order", "scopes must be left in the reverse order of entry", "use `with`")
SCOPE_OPEN: Final = Rule(
    "scope-open", "this can't be done while a scope is open", "leave the scope's `with` block first"
)
BINDING_NAME: Final = Rule("binding-name", "a binding can't have this name", "rename the shader's field")

# -- commands and the null device ------------------------------------------------------------------------

COMMAND_ARGUMENT: Final = Rule("command-argument", "the command has no such argument")
COMMAND_CLEARED: Final = Rule(
    "command-cleared",
    "the state at a command can't be read after its stream was cleared",
    "read it before clear()",
)
ASSERTION_ARGUMENT: Final = Rule(
    "assertion-argument", "an argument is invalid, so the assertion would match nothing or check nothing"
)
NULL_SAMPLES: Final = Rule(
    "null-samples",
    "nothing was rasterised, so the number of samples that passed is unknown",
    "define the answers with backend.answer_queries(...) or backend.count_samples(...)",
)
NULL_ANSWER: Final = Rule("null-answer", "not a number of samples")

# -- images ------------------------------------------------------------------------------------------------

IMAGE_FILE: Final = Rule("image-file", "the file can't be read or written as an image")
PLOT_LIBRARY: Final = Rule("plot-library", "plots need a library", 'pip install "rhi[renderer]"')
IMAGE_LIBRARY: Final = Rule("image-library", "image files need a library", 'pip install "rhi[images]"')

# -- cameras -----------------------------------------------------------------------------------------------

CAMERA_VALUE: Final = Rule("camera-bad-value", "a camera's value is out of its range")
