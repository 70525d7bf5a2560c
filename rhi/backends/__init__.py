"""Implementations of `rhi.backend.Backend`: one package per platform, none importing another, no policy inside."""
