"""WGSL, the language of WebGPU: a writer of stages from the typed tree."""
