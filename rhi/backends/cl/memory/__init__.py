"""Device memory: buffers, textures as planes of texels, samplers, and memory in flight."""
