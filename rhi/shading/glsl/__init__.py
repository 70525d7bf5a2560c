"""From the typed tree to GLSL."""
