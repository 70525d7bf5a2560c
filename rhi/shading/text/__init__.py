"""The parts that the writers of GLSL and its like share."""
