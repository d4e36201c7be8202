"""Inpainting without weights that continues structure: patches of the known part, found by PatchMatch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orca.conventions import Float32Array, to_float, to_uint8
from orca.errors import Unavailable
from orca.priors.inpaint import InpaintFailed, check_hole, paste_hole

__all__ = ["ExemplarInpainter"]


@dataclass(frozen=True)
class ExemplarInpainter:
    """``classical``: every hole pixel is a vote of patches from elsewhere in the image (Barnes et al. 2009).

    Unlike diffusion (`TeleaInpainter`) it keeps the image's own texture and sharpness; unlike a generative model it
    knows nothing but this image. Works at 8 bits, from the coarsest level of a pyramid to the finest.

    Attributes:
        radius: of the compared patches, in pixels.
        seed: of the randomised search.
    """

    radius: int = 3
    seed: int = 0
    name: str = "classical"

    def inpaint(self, image: Float32Array, mask: NDArray[np.bool_]) -> Float32Array:
        """See `Inpainter`. Raises `Unavailable` where the package PyPatchMatch does not run."""
        check_hole(image, mask)
        if not mask.any():
            return np.array(image, np.float32)
        try:
            import patchmatch
        except (ImportError, OSError) as error:
            raise _unavailable(str(error)) from error
        if not patchmatch.patchmatch_available:
            raise _unavailable("its native library does not load")
        known = np.where(mask[..., None], np.float32(0), image)
        patchmatch.set_random_seed(self.seed)
        try:
            filled = patchmatch.inpaint(to_uint8(known), mask, patch_size=self.radius)
        except (RuntimeError, ValueError, MemoryError) as error:
            raise InpaintFailed(
                f"PatchMatch failed ({type(error).__name__}: {error})", "an image with a hole", "use another inpainter"
            ) from error
        return paste_hole(image, mask, to_float(filled), self.name)


def _unavailable(why: str) -> Unavailable:
    return Unavailable(
        f"the exemplar inpainter needs the package PyPatchMatch: {why}",
        "PyPatchMatch 2.2 or later",
        "pip install PyPatchMatch, or choose --inpainter telea",
    )
