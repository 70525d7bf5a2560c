"""The lab: reference renderers, the exam, and comparisons of speed and accuracy. Only commands import it."""
