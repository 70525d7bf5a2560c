"""What the writers of GLSL and its like share."""
