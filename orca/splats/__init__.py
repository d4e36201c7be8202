"""Scenes as plain Gaussian splats: baked, rendered, written."""
