"""The pairs of texts that CLIP-IQA compares an image with, the better one first."""

from __future__ import annotations

__all__ = ["FIVE_PAIRS", "PHOTO_PAIR", "PROMPT_PAIRS"]

PROMPT_PAIRS = (
    ("Good image", "bad image"),
    ("Sharp image", "blurry image"),
    ("sharp edges", "blurry edges"),
    ("High resolution image", "low resolution image"),
    ("Noise-free image", "noisy image"),
    ("Good photo.", "Bad photo."),
)
FIVE_PAIRS = slice(0, 5)  # pyiqa's `clipiqa` is the mean over these
PHOTO_PAIR = 5  # the pair of the CLIP-IQA paper
