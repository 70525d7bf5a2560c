"""Lowering: from the typed tree to lane code."""
