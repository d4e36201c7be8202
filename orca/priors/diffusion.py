"""Stable Diffusion 1.5 inpainting, run by diffusers (paper, "Implementation Details")."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from orca.conventions import Float32Array
from orca.errors import BadInput, Unavailable
from orca.priors.diffusion_config import DiffusionConfig
from orca.priors.hub import SD15_INPAINTING, ModelAccess, locate
from orca.priors.inpaint import InpaintFailed, check_hole, paste_hole

__all__ = ["DiffusionInpainter"]

_MULTIPLE = 8  # the autoencoder's factor: both sides of what the network sees are multiples of it


@dataclass
class DiffusionInpainter:
    """``sd15``: Stable Diffusion 1.5 inpainting (Rombach et al. 2022).

    Weights are found and loaded at the first image. One seed gives one picture, on one machine and device.
    """

    access: ModelAccess = field(default_factory=ModelAccess)
    config: DiffusionConfig = field(default_factory=DiffusionConfig)
    seed: int = 0
    name: str = "sd15"
    _pipeline: Any = None

    def load(self) -> Any:
        """The pipeline, loaded once; half precision on a GPU.

        Raises:
            Unavailable: files are missing, or diffusers is not installed.
            BadInput: the files are no such pipeline.
        """
        if self._pipeline is None:
            self._pipeline = _load(self.access)
        return self._pipeline

    def inpaint(self, image: Float32Array, mask: NDArray[np.bool_]) -> Float32Array:
        """See `Inpainter`."""
        check_hole(image, mask)
        if not mask.any():
            return np.array(image, np.float32)
        height, width = mask.shape
        size = _network_size(width, height, self.config.side)
        known = np.where(mask[..., None], np.float32(0), image)
        given = _resized(np.asarray(known, np.float32), size)
        # Whatever of a network pixel is unknown makes it unknown.
        hole = _resized(mask.astype(np.float32), size) > 1e-3
        generated = self._generate(np.clip(given, 0.0, 1.0), hole)
        if generated.shape != given.shape:
            raise InpaintFailed(f"{self.name} returned shape {generated.shape}", f"{given.shape}", "use another one")
        return paste_hole(image, mask, _resized(generated, (width, height)), self.name)

    def _generate(self, image: Float32Array, hole: NDArray[np.bool_]) -> Float32Array:
        """The pipeline's picture of what the network sees, [h, w, 3]."""
        import torch

        from orca.threads import multi_threaded_torch

        pipeline = self.load()
        height, width = hole.shape
        try:
            with multi_threaded_torch():
                output = pipeline(
                    prompt=self.config.prompt,
                    negative_prompt=self.config.negative_prompt,
                    image=torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1)[None])),
                    mask_image=torch.from_numpy(hole[None, None].astype(np.float32)),
                    height=height,
                    width=width,
                    strength=1.0,
                    num_inference_steps=self.config.steps,
                    guidance_scale=self.config.guidance,
                    generator=torch.Generator("cpu").manual_seed(self.seed),
                    output_type="np",
                )
        except (RuntimeError, ValueError, MemoryError) as error:
            raise InpaintFailed(
                f"Stable Diffusion failed on {width}x{height} pixels ({type(error).__name__}: {str(error)[:200]})",
                "an image that fits into the device's memory",
                "use --device cpu, or another inpainter",
            ) from error
        return np.asarray(output.images[0], np.float32)


def _network_size(width: int, height: int, side: int) -> tuple[int, int]:
    """(width, height) that the network sees: the longer side is ``side``, both are multiples of 8."""
    scale = side / max(width, height)

    def fit(length: int) -> int:
        return max(_MULTIPLE, _MULTIPLE * round(length * scale / _MULTIPLE))

    return min(fit(width), side), min(fit(height), side)


def _resized(image: Float32Array, size: tuple[int, int]) -> Float32Array:
    """``image`` at another (width, height): area means when it shrinks, cubic when it grows."""
    height, width = image.shape[:2]
    if (width, height) == size:
        return image
    shrinks = size[0] <= width and size[1] <= height
    interpolation = cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(image, size, interpolation=interpolation), np.float32)


def _load(access: ModelAccess) -> Any:
    folder = locate(SD15_INPAINTING, access)
    try:
        import torch
        from diffusers import StableDiffusionInpaintPipeline
    except ImportError as error:
        raise Unavailable(
            f"Stable Diffusion: the package diffusers is not installed ({error})",
            "the optional dependencies 'models'",
            "pip install 'orca-nvs[models]'",
        ) from error
    try:
        pipeline = StableDiffusionInpaintPipeline.from_pretrained(
            folder,
            use_safetensors=True,
            local_files_only=True,
            # The repository's checker is no part of the method; it would also turn a picture it dislikes black.
            safety_checker=None,
            feature_extractor=None,
            requires_safety_checker=False,
        )
    except Exception as error:
        # Whatever diffusers stumbles over (json, safetensors, shapes), the files are not this pipeline.
        raise BadInput(
            f"Stable Diffusion in {folder} does not load ({type(error).__name__}: {str(error)[:200]})",
            f"the files of huggingface.co/{SD15_INPAINTING.repo}",
            "get them again",
        ) from error
    pipeline.set_progress_bar_config(disable=True)
    return pipeline.to(access.device, torch.float16 if access.device == "cuda" else torch.float32)
