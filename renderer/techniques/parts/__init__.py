"""Parts of techniques: shaders and passes that several of them are composed of. A technique imports parts,
and never another technique."""
