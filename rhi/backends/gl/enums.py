"""The GL enumerants that this backend uses, with their GL names without `GL_`."""

from __future__ import annotations

from typing import Final

__rhi_internal__ = True

# -- errors and strings --------------------------------------------------------------------------------------

NO_ERROR: Final = 0
INVALID_ENUM: Final = 0x0500
INVALID_VALUE: Final = 0x0501
INVALID_OPERATION: Final = 0x0502
INVALID_FRAMEBUFFER_OPERATION: Final = 0x0506
OUT_OF_MEMORY: Final = 0x0505
CONTEXT_LOST: Final = 0x0507
RENDERER: Final = 0x1F01
VERSION: Final = 0x1F02

# -- limits --------------------------------------------------------------------------------------------------

MAX_TEXTURE_SIZE: Final = 0x0D33
MAX_3D_TEXTURE_SIZE: Final = 0x8073
MAX_ARRAY_TEXTURE_LAYERS: Final = 0x88FF
MAX_DRAW_BUFFERS: Final = 0x8824
MAX_COLOR_ATTACHMENTS: Final = 0x8CDF
MAX_COLOR_TEXTURE_SAMPLES: Final = 0x910E
MAX_DEPTH_TEXTURE_SAMPLES: Final = 0x910F
MAX_VERTEX_ATTRIBS: Final = 0x8869
MAX_UNIFORM_BLOCK_SIZE: Final = 0x8A30
MAX_SHADER_STORAGE_BLOCK_SIZE: Final = 0x90DE
MAX_VERTEX_UNIFORM_BLOCKS: Final = 0x8A2B
MAX_FRAGMENT_UNIFORM_BLOCKS: Final = 0x8A2D
MAX_COMPUTE_UNIFORM_BLOCKS: Final = 0x91BB
MAX_FRAGMENT_SHADER_STORAGE_BLOCKS: Final = 0x90DA
MAX_COMPUTE_SHADER_STORAGE_BLOCKS: Final = 0x90DB
MAX_TEXTURE_IMAGE_UNITS: Final = 0x8872
MAX_VERTEX_TEXTURE_IMAGE_UNITS: Final = 0x8B4C
MAX_COMPUTE_TEXTURE_IMAGE_UNITS: Final = 0x91BC
MAX_FRAGMENT_IMAGE_UNIFORMS: Final = 0x90CE
MAX_COMPUTE_IMAGE_UNIFORMS: Final = 0x91BD
MAX_IMAGE_UNITS: Final = 0x8F38
MAX_COMPUTE_WORK_GROUP_SIZE: Final = 0x91BF
MAX_COMPUTE_WORK_GROUP_COUNT: Final = 0x91BE
MAX_COMPUTE_WORK_GROUP_INVOCATIONS: Final = 0x90EB
MAX_COMPUTE_SHARED_MEMORY_SIZE: Final = 0x8262
MAX_TEXTURE_MAX_ANISOTROPY: Final = 0x84FF
UNIFORM_BUFFER_OFFSET_ALIGNMENT: Final = 0x8A34
SHADER_STORAGE_BUFFER_OFFSET_ALIGNMENT: Final = 0x90DF
QUERY_COUNTER_BITS: Final = 0x8864

# -- types and pixel formats ---------------------------------------------------------------------------------

UNSIGNED_BYTE: Final = 0x1401
BYTE: Final = 0x1400
UNSIGNED_SHORT: Final = 0x1403
SHORT: Final = 0x1402
UNSIGNED_INT: Final = 0x1405
INT: Final = 0x1404
HALF_FLOAT: Final = 0x140B
FLOAT: Final = 0x1406
UNSIGNED_INT_24_8: Final = 0x84FA
FLOAT_32_UNSIGNED_INT_24_8_REV: Final = 0x8DAD
RED: Final = 0x1903
RG: Final = 0x8227
RGBA: Final = 0x1908
RED_INTEGER: Final = 0x8D94
RG_INTEGER: Final = 0x8228
RGBA_INTEGER: Final = 0x8D99
DEPTH_COMPONENT: Final = 0x1902
STENCIL_INDEX: Final = 0x1901
DEPTH_STENCIL: Final = 0x84F9

# -- internal formats ----------------------------------------------------------------------------------------

R8: Final = 0x8229
RG8: Final = 0x822B
RGBA8: Final = 0x8058
SRGB8_ALPHA8: Final = 0x8C43
R8_SNORM: Final = 0x8F94
RG8_SNORM: Final = 0x8F95
RGBA8_SNORM: Final = 0x8F97
R16: Final = 0x822A
RG16: Final = 0x822C
RGBA16: Final = 0x805B
R16F: Final = 0x822D
RG16F: Final = 0x822F
RGBA16F: Final = 0x881A
R32F: Final = 0x822E
RG32F: Final = 0x8230
RGBA32F: Final = 0x8814
R8UI: Final = 0x8232
RG8UI: Final = 0x8238
RGBA8UI: Final = 0x8D7C
R16UI: Final = 0x8234
RG16UI: Final = 0x823A
RGBA16UI: Final = 0x8D76
R32UI: Final = 0x8236
RG32UI: Final = 0x823C
RGBA32UI: Final = 0x8D70
R32I: Final = 0x8235
RG32I: Final = 0x823B
RGBA32I: Final = 0x8D82
DEPTH_COMPONENT16: Final = 0x81A5
DEPTH_COMPONENT24: Final = 0x81A6
DEPTH_COMPONENT32F: Final = 0x8CAC
DEPTH24_STENCIL8: Final = 0x88F0
DEPTH32F_STENCIL8: Final = 0x8CAD

# -- textures and samplers -----------------------------------------------------------------------------------

TEXTURE: Final = 0x1702
TEXTURE_2D: Final = 0x0DE1
TEXTURE_2D_ARRAY: Final = 0x8C1A
TEXTURE_3D: Final = 0x806F
TEXTURE_CUBE_MAP: Final = 0x8513
TEXTURE_2D_MULTISAMPLE: Final = 0x9100
TEXTURE_MIN_FILTER: Final = 0x2801
TEXTURE_MAG_FILTER: Final = 0x2800
TEXTURE_WRAP_S: Final = 0x2802
TEXTURE_WRAP_T: Final = 0x2803
TEXTURE_WRAP_R: Final = 0x8072
TEXTURE_BORDER_COLOR: Final = 0x1004
TEXTURE_COMPARE_MODE: Final = 0x884C
TEXTURE_COMPARE_FUNC: Final = 0x884D
TEXTURE_MAX_ANISOTROPY: Final = 0x84FE
COMPARE_REF_TO_TEXTURE: Final = 0x884E
NEAREST: Final = 0x2600
LINEAR: Final = 0x2601
NEAREST_MIPMAP_NEAREST: Final = 0x2700
LINEAR_MIPMAP_NEAREST: Final = 0x2701
NEAREST_MIPMAP_LINEAR: Final = 0x2702
LINEAR_MIPMAP_LINEAR: Final = 0x2703
REPEAT: Final = 0x2901
MIRRORED_REPEAT: Final = 0x8370
CLAMP_TO_EDGE: Final = 0x812F
CLAMP_TO_BORDER: Final = 0x812D
PACK_ROW_LENGTH: Final = 0x0D02
PACK_ALIGNMENT: Final = 0x0D05
UNPACK_ROW_LENGTH: Final = 0x0CF2
UNPACK_ALIGNMENT: Final = 0x0CF5
READ_WRITE: Final = 0x88BA

# -- framebuffers --------------------------------------------------------------------------------------------

FRAMEBUFFER: Final = 0x8D40
FRAMEBUFFER_COMPLETE: Final = 0x8CD5
FRAMEBUFFER_DEFAULT_WIDTH: Final = 0x9310
FRAMEBUFFER_DEFAULT_HEIGHT: Final = 0x9311
FRAMEBUFFER_DEFAULT_SAMPLES: Final = 0x9313
COLOR_ATTACHMENT0: Final = 0x8CE0
DEPTH_ATTACHMENT: Final = 0x8D00
DEPTH_STENCIL_ATTACHMENT: Final = 0x821A
COLOR: Final = 0x1800
DEPTH: Final = 0x1801
STENCIL: Final = 0x1802
COLOR_BUFFER_BIT: Final = 0x00004000
FRAMEBUFFER_SRGB: Final = 0x8DB9

# -- buffers -------------------------------------------------------------------------------------------------

BUFFER: Final = 0x82E0
PROGRAM: Final = 0x82E2
DRAW_INDIRECT_BUFFER: Final = 0x8F3F
PIXEL_PACK_BUFFER: Final = 0x88EB
PIXEL_UNPACK_BUFFER: Final = 0x88EC
PARAMETER_BUFFER: Final = 0x80EE
MAP_READ_BIT: Final = 0x0001
MAP_WRITE_BIT: Final = 0x0002
MAP_PERSISTENT_BIT: Final = 0x0040
MAP_COHERENT_BIT: Final = 0x0080
ALL_BARRIER_BITS: Final = 0xFFFFFFFF

# -- primitives ----------------------------------------------------------------------------------------------

POINTS: Final = 0x0000
LINES: Final = 0x0001
LINE_STRIP: Final = 0x0003
TRIANGLES: Final = 0x0004
TRIANGLE_STRIP: Final = 0x0005
TRIANGLE_FAN: Final = 0x0006
PRIMITIVE_RESTART: Final = 0x8F9D
PRIMITIVE_RESTART_FIXED_INDEX: Final = 0x8D69
FIRST_VERTEX_CONVENTION: Final = 0x8E4D
PROGRAM_POINT_SIZE: Final = 0x8642
POINT_SPRITE_COORD_ORIGIN: Final = 0x8CA0
LOWER_LEFT: Final = 0x8CA1
ZERO_TO_ONE: Final = 0x935F

# -- states --------------------------------------------------------------------------------------------------

CULL_FACE: Final = 0x0B44
FRONT: Final = 0x0404
BACK: Final = 0x0405
CW: Final = 0x0900
CCW: Final = 0x0901
DEPTH_TEST: Final = 0x0B71
STENCIL_TEST: Final = 0x0B90
SCISSOR_TEST: Final = 0x0C11
BLEND: Final = 0x0BE2
DITHER: Final = 0x0BD0
SAMPLE_ALPHA_TO_COVERAGE: Final = 0x809E
POLYGON_OFFSET_FILL: Final = 0x8037
NEVER: Final = 0x0200
LESS: Final = 0x0201
EQUAL: Final = 0x0202
LEQUAL: Final = 0x0203
GREATER: Final = 0x0204
NOTEQUAL: Final = 0x0205
GEQUAL: Final = 0x0206
ALWAYS: Final = 0x0207
ZERO: Final = 0
ONE: Final = 1
SRC_COLOR: Final = 0x0300
ONE_MINUS_SRC_COLOR: Final = 0x0301
SRC_ALPHA: Final = 0x0302
ONE_MINUS_SRC_ALPHA: Final = 0x0303
DST_COLOR: Final = 0x0306
ONE_MINUS_DST_COLOR: Final = 0x0307
DST_ALPHA: Final = 0x0304
ONE_MINUS_DST_ALPHA: Final = 0x0305
CONSTANT_COLOR: Final = 0x8001
ONE_MINUS_CONSTANT_COLOR: Final = 0x8002
SRC_ALPHA_SATURATE: Final = 0x0308
FUNC_ADD: Final = 0x8006
FUNC_SUBTRACT: Final = 0x800A
FUNC_REVERSE_SUBTRACT: Final = 0x800B
MIN: Final = 0x8007
MAX: Final = 0x8008
KEEP: Final = 0x1E00
REPLACE: Final = 0x1E01
INCR: Final = 0x1E02
INCR_WRAP: Final = 0x8507
DECR: Final = 0x1E03
DECR_WRAP: Final = 0x8508
INVERT: Final = 0x150A

# -- queries and fences --------------------------------------------------------------------------------------

SAMPLES_PASSED: Final = 0x8914
TIMESTAMP: Final = 0x8E28
QUERY_RESULT: Final = 0x8866
QUERY_RESULT_AVAILABLE: Final = 0x8867
QUERY_WAIT: Final = 0x8E13
QUERY_WAIT_INVERTED: Final = 0x8E17
SYNC_GPU_COMMANDS_COMPLETE: Final = 0x9117
SYNC_FLUSH_COMMANDS_BIT: Final = 0x00000001
ALREADY_SIGNALED: Final = 0x911A
CONDITION_SATISFIED: Final = 0x911C

# -- debug output --------------------------------------------------------------------------------------------

DEBUG_OUTPUT: Final = 0x92E0
DEBUG_OUTPUT_SYNCHRONOUS: Final = 0x8242
DEBUG_TYPE_ERROR: Final = 0x824C
DEBUG_TYPE_UNDEFINED_BEHAVIOR: Final = 0x824E
DEBUG_SOURCE_APPLICATION: Final = 0x824A
