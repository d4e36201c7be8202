"""The one entry to rendering: a scene and a camera in, an image, its coverage and its depth out."""

from __future__ import annotations

from copy import copy, deepcopy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray

from orca.anchors import GaussianAnchors
from orca.camera import Camera
from orca.config import RenderConfig
from orca.conventions import Float32Array
from orca.field.decoders import Decoders
from orca.render import fast
from orca.render.conics import project_anchors
from orca.render.hits import HitList
from orca.render.reference import render_rays
from orca.render.selector import select_whitened

if TYPE_CHECKING:
    from orca.scene import Scene

__all__ = ["Renderer", "Rendering", "render"]

_REFERENCE_RAYS = 16384  # rays a chunk: keeps the padded tensors of the reference path small


@dataclass(frozen=True, eq=False)
class Rendering:
    """One rendered view.

    Attributes:
        rgb: colour over the background, [H, W, 3] float32 in [0, 1].
        alpha: accumulated alpha, [H, W] float32 in [0, 1].
        depth: expected z-depth of what is there (sum T alpha t / alpha), 0 where alpha is 0, [H, W] float32.
        overflow: hits beyond the cap.
    """

    rgb: Float32Array
    alpha: Float32Array
    depth: Float32Array
    overflow: int


class Renderer:
    """Renders many views of one set of anchors; what does not depend on the view is computed once.

    Args:
        anchors: the anchors.
        decoders: the field's decoders.
        config: how to render.
        device: "cpu" takes the compiled path; any other torch device takes the reference in torch operations.
    """

    def __init__(self, anchors: GaussianAnchors, decoders: Decoders, config: RenderConfig, device: str = "cpu") -> None:
        self.config, self.device = config, device
        # `Module.to` moves in place: a copy, or the scene's own decoders would leave the CPU with the renderer's.
        self.decoders = decoders if device == "cpu" else deepcopy(decoders).to(device)
        self.anchors = anchors.detached().to(device)
        with torch.inference_mode():
            self.means = np.ascontiguousarray(anchors.means.detach().cpu().numpy())
            self.whitening = np.ascontiguousarray(anchors.whitening().detach().cpu().numpy())
            self.opacity = torch.sigmoid(anchors.opacity_logits.detach()).cpu().numpy()
            self.hidden = self.decoders.density_in(self.anchors.features).cpu().numpy()

    def extended(self, more: Renderer) -> Renderer:
        """A renderer of these anchors followed by those of ``more`` (same decoders and configuration)."""
        whole = copy(self)
        whole.anchors = GaussianAnchors.concatenate(self.anchors, more.anchors)
        for name in ("means", "whitening", "opacity", "hidden"):
            setattr(whole, name, np.concatenate([getattr(self, name), getattr(more, name)]))
        return whole

    def part(self, keep: NDArray[np.bool_]) -> Renderer:
        """A renderer of some of the anchors, in the same order: the same image wherever the others do not reach."""
        some = copy(self)
        some.anchors = self.anchors.subset(torch.from_numpy(np.flatnonzero(keep)))
        for name in ("means", "whitening", "opacity", "hidden"):
            setattr(some, name, getattr(self, name)[keep])
        return some

    def boxes(self, camera: Camera) -> NDArray[np.int32]:
        """Pixel box (x0, y0, x1, y1) of each anchor's footprint in a view, [N, 4]; x1 <= x0 where there is none."""
        size = (camera.width, camera.height)
        limits = (self.config.chi2, self.config.near)
        pose, rays = camera.world_to_camera, camera.pixel_to_ray()
        out: NDArray[np.int32] = project_anchors(self.means, self.whitening, pose, camera.K, rays, size, *limits)[1]
        return out

    def hits(self, camera: Camera) -> HitList:
        """Which anchors each pixel sees."""
        return select_whitened(self.means, self.whitening, camera, self.config)

    def render(self, camera: Camera, hits: HitList | None = None) -> Rendering:
        """Render one view; ``hits`` may be passed when they are known already."""
        hits = self.hits(camera) if hits is None else hits
        pixels = self._fast(camera, hits) if self.device == "cpu" else self._reference(camera, hits)
        shape = (camera.height, camera.width)
        alpha = pixels[:, 3].reshape(shape)
        rgb = pixels[:, :3].reshape(*shape, 3) + (1 - alpha[..., None]) * np.float32(self.config.background)
        with np.errstate(invalid="ignore", divide="ignore"):
            depth = np.where(alpha > 0, pixels[:, 4].reshape(shape) / alpha, 0).astype(np.float32)
        return Rendering(np.ascontiguousarray(rgb), np.ascontiguousarray(alpha), depth, hits.overflow)

    def _fast(self, camera: Camera, hits: HitList) -> Float32Array:
        samples = fast.aggregate(hits, self.opacity, self.hidden, self.config)
        directions = fast.view_directions(camera, samples.ray) if self.decoders.use_direction else None
        sigma, colour = fast.decode(self.decoders, samples.features, directions)
        out: Float32Array = fast.composite_samples(
            samples.start, sigma.numpy(), samples.opacity, colour.numpy(), samples.t
        )
        return out

    def _reference(self, camera: Camera, hits: HitList) -> Float32Array:
        out = np.zeros((hits.num_rays, 5), np.float32)
        rays = np.flatnonzero(hits.count > 0)
        for low in range(0, len(rays), _REFERENCE_RAYS):
            part = rays[low : low + _REFERENCE_RAYS]
            pixels = np.stack([part % camera.width + 0.5, part // camera.width + 0.5], 1)
            with torch.inference_mode():
                rgb, alpha, depth = render_rays(
                    self.anchors,
                    self.decoders,
                    camera,
                    torch.as_tensor(pixels, dtype=torch.float32, device=self.device),
                    torch.from_numpy(hits.padded(part)).to(self.device),
                    self.config,
                )
            out[part] = torch.cat([rgb, alpha[:, None], depth[:, None]], 1).cpu().numpy()
        return out


def render(scene: Scene, camera: Camera, device: str = "cpu") -> Rendering:
    """Render one view of a scene (see `Renderer` for many)."""
    return scene.renderer(device).render(camera)
