"""Implementations of `rhi.contract.Backend`, one package per platform. None imports another or holds
policy."""
