"""Comparisons of techniques, visibility algorithms, tests of light culling, eyes, encodings, buffers and backends."""
