"""The tile rasteriser: from draw calls to pixels, in OpenCL kernels."""
