"""Code specific to PoCL: its cache of kernels, its header, its threads, and the memory of its programs."""
