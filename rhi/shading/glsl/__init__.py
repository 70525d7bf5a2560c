"""GLSL from the typed tree."""
