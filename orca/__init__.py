"""ORCA: one image to one explorable 3D scene."""
