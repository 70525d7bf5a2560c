"""Resources as users hold them: buffers, textures, meshes and programs, with their locks and lifetimes."""
