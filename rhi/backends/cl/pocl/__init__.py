"""Knowledge of PoCL: its cache of kernels, its header, its threads, and the memory that its programs take."""
