"""The constants of Stable Diffusion (paper, "Implementation Details")."""

from __future__ import annotations

from dataclasses import dataclass

from orca.errors import BadInput

__all__ = ["DiffusionConfig"]


@dataclass(frozen=True)
class DiffusionConfig:
    """How Stable Diffusion is asked.

    Attributes:
        steps: denoising steps (P: 30).
        guidance: classifier-free guidance scale (P: 7).
        side: longer side in pixels of what the network sees; smaller and larger images are resized to it (P: at most
            512; O: exactly, since the network was trained at 512).
        prompt: what should be there (O; the paper names none). It asks for no object of its own.
        negative_prompt: what should not (O).
    """

    steps: int = 30
    guidance: float = 7.0
    side: int = 512
    prompt: str = "the background of the scene continues seamlessly, empty, natural, photo"
    negative_prompt: str = "text, watermark, frame, border, person, new object, blurry, distorted"

    def __post_init__(self) -> None:
        if self.steps < 1 or self.side < 8 or not self.guidance >= 0:
            raise BadInput(
                f"diffusion with {self.steps} steps, guidance {self.guidance} and a side of {self.side}",
                f"at least 1 step, guidance >= 0, a side of at least {8}",
                "correct the configuration",
            )
