"""Resources: buffers, textures, meshes and programs, with their locks and lifetimes."""
