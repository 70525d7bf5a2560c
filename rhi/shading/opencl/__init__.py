"""Translation of lane code to OpenCL C."""
