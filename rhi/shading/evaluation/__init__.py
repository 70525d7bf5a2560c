"""Shading functions and stages run on the CPU, on NumPy, in float32 or float64."""
