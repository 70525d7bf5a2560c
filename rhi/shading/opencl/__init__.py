"""From lane code to OpenCL C."""
