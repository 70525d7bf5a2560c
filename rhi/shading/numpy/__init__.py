"""From lane code to Python that computes with NumPy, and what it runs on."""
