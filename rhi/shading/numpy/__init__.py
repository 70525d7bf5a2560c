"""Translation of lane code to Python that computes with NumPy, and the runtime that it needs."""
