"""Memory of the device: buffers, textures as planes of texels, samplers, and what is kept until the fence."""
