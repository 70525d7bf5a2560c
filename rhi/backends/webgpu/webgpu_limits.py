"""The limits that every implementation of WebGPU has (section 3.6.2 of its specification)."""

from __future__ import annotations

from typing import Final

CORE_LIMITS: Final = {
    "max-texture-dimension-1d": 8192, "max-texture-dimension-2d": 8192, "max-texture-dimension-3d": 2048,
    "max-texture-array-layers": 256, "max-bind-groups": 4, "max-bindings-per-bind-group": 1000,
    "max-dynamic-uniform-buffers-per-pipeline-layout": 8, "max-dynamic-storage-buffers-per-pipeline-layout": 4,
    "max-sampled-textures-per-shader-stage": 16, "max-samplers-per-shader-stage": 16,
    "max-storage-buffers-per-shader-stage": 8, "max-storage-textures-per-shader-stage": 4,
    "max-uniform-buffers-per-shader-stage": 12, "max-uniform-buffer-binding-size": 1 << 16,
    "max-storage-buffer-binding-size": 1 << 27, "min-uniform-buffer-offset-alignment": 256,
    "min-storage-buffer-offset-alignment": 256, "max-vertex-buffers": 8, "max-buffer-size": 1 << 28,
    "max-vertex-attributes": 16, "max-vertex-buffer-array-stride": 2048, "max-inter-stage-shader-variables": 16,
    "max-color-attachments": 8, "max-color-attachment-bytes-per-sample": 32,
    "max-compute-workgroup-storage-size": 16384, "max-compute-invocations-per-workgroup": 256,
    "max-compute-workgroup-size-x": 256, "max-compute-workgroup-size-y": 256, "max-compute-workgroup-size-z": 64,
    "max-compute-workgroups-per-dimension": 65535,
}  # fmt: skip
"""The limits that every implementation of WebGPU has."""
