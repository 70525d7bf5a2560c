"""A renderer written once against `rhi`: scenes, visibility, techniques and their measurements."""
