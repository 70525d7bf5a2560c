"""Execution of shading functions and stages on the CPU with NumPy, in float32 or float64."""
