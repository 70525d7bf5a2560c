"""Generators of the language's type stubs and of its reference page."""
