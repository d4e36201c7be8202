"""The one entry to rendering: a scene and a camera in, an image, its coverage and its depth out."""

from __future__ import annotations

from copy import copy, deepcopy
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray

from orca.anchors import GaussianAnchors
from orca.camera import Camera
from orca.config import RenderConfig
from orca.conventions import Float32Array
from orca.field.decoders import SH_DIM, Decoders, spherical_harmonics
from orca.render.compact import CompactDecoders
from orca.render.conics import project_anchors
from orca.render.expand import expand_hits
from orca.render.flat import FlatHits, render_flat
from orca.render.frame import FieldTables, Mode, render_tiles
from orca.render.hits import HitList
from orca.render.reference import render_rays
from orca.render.rows import SharedRows
from orca.render.selector import footprints, select_whitened
from orca.render.tiles import Footprints, tile_pixels
from orca.threads import map_on_cores, single_threaded_blas

if TYPE_CHECKING:
    from orca.scene import Scene

__all__ = ["Backend", "Renderer", "Rendering", "render"]

Backend = Literal["compiled", "torch", "reference"]

_PIECES = 16  # shares of the tiles that the cores take one at a time
_FLAT_RAYS = 1 << 17
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
        device: where to render.
        backend: "compiled" (CPU only), "torch" (any device) or "reference"; by default the first that the device has.
    """

    def __init__(
        self,
        anchors: GaussianAnchors,
        decoders: Decoders,
        config: RenderConfig,
        device: str = "cpu",
        backend: Backend | None = None,
    ) -> None:
        self.config, self.device = config, device
        self.backend: Backend = backend or ("compiled" if device == "cpu" else "torch")
        # `Module.to` moves in place: a copy, or the scene's own decoders would leave the CPU with the renderer's.
        self.decoders = decoders if device == "cpu" else deepcopy(decoders).to(device)
        self.anchors = anchors.detached().to(device)
        matrices = CompactDecoders.of(decoders)
        with torch.inference_mode():
            self.means = np.ascontiguousarray(anchors.means.detach().cpu().numpy())
            self.whitening = np.ascontiguousarray(anchors.whitening().detach().cpu().numpy())
            self.opacity = torch.sigmoid(anchors.opacity_logits.detach()).cpu().numpy()
            # The first density layer is linear and aggregation weights sum to one: applied once an anchor (5.3).
            self.carried = anchors.features.detach().cpu().numpy() @ matrices.density_in
        self.matrices = matrices
        self._rows: dict[str, SharedRows] = {}  # what extensions of this renderer share with it

    def extended(self, more: Renderer) -> Renderer:
        """A renderer of these anchors followed by those of ``more`` (same decoders and configuration)."""
        whole = copy(self)
        if self.anchors.means.device.type != "cpu":
            whole.anchors = GaussianAnchors.concatenate(self.anchors, more.anchors)
            for name in ("means", "whitening", "opacity", "carried"):
                setattr(whole, name, np.concatenate([getattr(self, name), getattr(more, name)]))
            return whole
        tables: dict[str, NDArray[Any]] = {}
        whole._rows = {}
        for name in (*(f.name for f in fields(GaussianAnchors)), "whitening", "opacity", "carried"):
            of_anchors = name in GaussianAnchors.__dataclass_fields__
            mine, other = (getattr(r.anchors, name).numpy() if of_anchors else getattr(r, name) for r in (self, more))
            whole._rows[name], tables[name] = self._rows.get(name, SharedRows(mine)).extended(len(mine), other)
        whole.means, whole.whitening = tables["means"], tables.pop("whitening")
        whole.opacity, whole.carried = tables.pop("opacity"), tables.pop("carried")
        whole.anchors = GaussianAnchors(**{name: torch.from_numpy(table) for name, table in tables.items()})
        return whole

    def part(self, keep: NDArray[np.bool_]) -> Renderer:
        """A renderer of some of the anchors, in the same order: the same image wherever the others do not reach."""
        some = copy(self)
        some._rows = {}
        some.anchors = self.anchors.subset(torch.from_numpy(np.flatnonzero(keep)))
        for name in ("means", "whitening", "opacity", "carried"):
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

    def render(self, camera: Camera) -> Rendering:
        """Render one view."""
        paths = {"compiled": self._tiles, "torch": self._flat, "reference": self._reference}
        pixels, overflow = paths[self.backend](camera)
        shape = (camera.height, camera.width)
        rgb, alpha, depth = self.finished(pixels)
        return Rendering(rgb.reshape(*shape, 3), alpha.reshape(shape), depth.reshape(shape), overflow)

    def finished(self, pixels: Float32Array) -> tuple[Float32Array, Float32Array, Float32Array]:
        """Colour over the background, alpha and expected depth of pixels [n, 5], as `render_tiles` leaves them."""
        alpha = np.ascontiguousarray(pixels[:, 3])
        rgb = pixels[:, :3] + (1 - alpha[:, None]) * np.float32(self.config.background)
        with np.errstate(invalid="ignore", divide="ignore"):
            depth = np.where(alpha > 0, pixels[:, 4] / alpha, 0).astype(np.float32)
        return np.ascontiguousarray(rgb), alpha, depth

    def _tiles(self, camera: Camera) -> tuple[Float32Array, int]:
        where, _ = footprints(self.means, self.whitening, camera, self.config)
        tiles = np.arange(len(where.offset) - 1)
        out, _, overflow = self.render_tiles(camera, where, self.opacity, self.carried, tiles)
        return out, overflow

    def render_tiles(
        self,
        camera: Camera,
        where: Footprints,
        opacity: Float32Array,
        carried: Float32Array,
        tiles: NDArray[np.int64],
        newest: int = 0,
    ) -> tuple[Float32Array, NDArray[np.bool_], int]:
        """Some tiles of a view, compiled: pixels [H * W, 5], which of them have hits [H * W], hits beyond the cap.

        Args:
            camera: the view.
            where: the anchors that take part.
            opacity, carried: theirs, [n] and [n, hidden channels].
            tiles: which ones, row by row.
            newest: only rays that meet an anchor from this one on are rendered; 0: all of them.
        """
        size, config, m = (camera.width, camera.height), self.config, self.matrices
        directions = _harmonics(camera, tiles) if len(m.from_direction) else np.empty((0, SH_DIM), np.float32)
        field = FieldTables(opacity, carried, m.density, m.from_geo, m.from_direction, m.middle, m.last, directions)
        gaps = (config.layer_gap_sigmas, config.layer_gap_relative)
        limits, layered = (config.chi2, config.near), config.decode == "layered"
        mode = Mode(limits, gaps, layered, config.window, config.max_hits, newest)
        out = np.zeros((camera.width * camera.height, 5), np.float32)
        met = np.zeros(len(out), bool)
        step = max(1, -(-len(tiles) // _PIECES))

        def work(first: int) -> int:
            overflow: int = render_tiles(tiles[first : first + step], size, where, field, mode, out, met)
            return overflow

        with single_threaded_blas():
            return out, met, sum(map_on_cores(work, range(0, len(tiles), step)))

    def _flat(self, camera: Camera) -> tuple[Float32Array, int]:
        hits, overflow = expand_hits(self.anchors, camera, self.config)
        pixels = torch.arange(hits.rays, device=hits.ray.device)
        pixels = torch.stack([pixels % camera.width + 0.5, pixels // camera.width + 0.5], 1).float()
        out = []
        bounds = torch.searchsorted(hits.ray, torch.arange(0, hits.rays + _FLAT_RAYS, _FLAT_RAYS).to(hits.ray))
        for i, low in enumerate(range(0, hits.rays, _FLAT_RAYS)):
            rows = slice(int(bounds[i]), int(bounds[i + 1]))
            some = pixels[low : low + _FLAT_RAYS]
            part = FlatHits(hits.ray[rows] - low, hits.anchor[rows], len(some))
            with torch.inference_mode():
                rgb, alpha, depth = render_flat(self.anchors, self.decoders, camera, some, part, self.config)
            out.append(torch.cat([rgb, alpha[:, None], depth[:, None]], 1))
        return torch.cat(out).cpu().numpy(), overflow

    def _reference(self, camera: Camera) -> tuple[Float32Array, int]:
        hits = self.hits(camera)
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
        return out, hits.overflow


def _harmonics(camera: Camera, tiles: NDArray[np.int64]) -> Float32Array:
    """Spherical harmonics of the viewing directions of some tiles' pixels, [H * W, 16]; 0 elsewhere."""
    pixel = tile_pixels(tiles, (camera.width, camera.height))
    centres = np.stack([pixel % camera.width + 0.5, pixel // camera.width + 0.5], 1)
    rays = torch.nn.functional.normalize(torch.from_numpy(camera.rays(centres)).float(), dim=1)
    out = np.zeros((camera.width * camera.height, SH_DIM), np.float32)
    out[pixel] = spherical_harmonics(rays).numpy()
    return out


def render(scene: Scene, camera: Camera, device: str = "cpu") -> Rendering:
    """Render one view of a scene (see `Renderer` for many)."""
    return scene.renderer(device).render(camera)
