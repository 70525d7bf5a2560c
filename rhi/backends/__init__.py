"""Implementations of `rhi.contract.Backend`, one package per platform. They don't import each other and hold no policy."""
