"""Filling a hole in an image: the protocol, the names, and what can go wrong."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from orca.conventions import Float32Array
from orca.errors import BadInput, OrcaError
from orca.registry import Registry

__all__ = ["INPAINTERS", "InpaintFailed", "Inpainter", "check_hole", "paste_hole"]


class InpaintFailed(OrcaError):
    """The inpainter itself failed or returned nonsense; the caller may fall back to another."""

    kind = "inpaint_failed"


class Inpainter(Protocol):
    """Image and hole in, image out."""

    @property
    def name(self) -> str:
        """Its name in the registry."""
        ...

    def inpaint(self, image: Float32Array, mask: NDArray[np.bool_]) -> Float32Array:
        """Fill the masked pixels; all others are kept bit for bit.

        Args:
            image: [H, W, 3] float32 in [0, 1]; what it holds under the mask is ignored.
            mask: [H, W] bool, True where a colour is wanted. An empty mask gives a copy.

        Raises:
            BadInput: wrong shapes or types, a NaN outside the hole, or a mask that leaves nothing to go by.
            InpaintFailed: the method failed.
        """
        ...


INPAINTERS: Registry[type[Inpainter]] = Registry(
    "inpainter",
    {
        "sd15": "orca.priors.diffusion:DiffusionInpainter",
        "classical": "orca.priors.exemplar:ExemplarInpainter",
        "telea": "orca.priors.classical:TeleaInpainter",
        "navier-stokes": "orca.priors.classical:NavierStokesInpainter",
        "nearest": "orca.priors.classical:NearestInpainter",
    },
)


def check_hole(image: Float32Array, mask: NDArray[np.bool_]) -> None:
    """Raise `BadInput` unless image [H, W, 3] and mask [H, W] bool fit and something outside the hole is known."""
    if image.ndim != 3 or image.shape[2] != 3 or mask.shape != image.shape[:2] or mask.dtype != np.bool_:
        raise BadInput(
            f"image of shape {image.shape} with a mask of shape {mask.shape} and type {mask.dtype}",
            "image [H, W, 3] and mask [H, W] bool",
            "give the mask of this image",
        )
    if bool(mask.all()):
        raise BadInput("a mask that covers the whole image", "some pixels outside the hole", "shrink the mask")
    if not bool(np.isfinite(image[~mask]).all()):
        raise BadInput("NaN or infinite colours outside the hole", "finite colours", "add them to the mask")


def paste_hole(image: Float32Array, mask: NDArray[np.bool_], filled: Float32Array, name: str) -> Float32Array:
    """``image`` with the masked pixels of ``filled``, clipped to [0, 1]; `InpaintFailed` if those are no colours."""
    if filled.shape != image.shape or not bool(np.isfinite(filled[mask]).all()):
        raise InpaintFailed(
            f"inpainter '{name}' returned shape {filled.shape}, or colours that are not finite",
            f"finite colours of shape {image.shape}",
            "use another inpainter",
        )
    result = np.array(image, np.float32)
    result[mask] = np.clip(filled[mask], 0.0, 1.0)
    return result
