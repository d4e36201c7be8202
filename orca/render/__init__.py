"""Rendering: one entry, `render(scene, camera)`."""

from orca.render.hits import HitList
from orca.render.renderer import Renderer, Rendering, render
from orca.render.selector import select, select_brute_force

__all__ = ["HitList", "Renderer", "Rendering", "render", "select", "select_brute_force"]
