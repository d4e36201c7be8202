"""CLIP-IQA's network: image features once a frame, text features once a run, through pyiqa or through open_clip.

CLIP-IQA (Wang et al. 2023, "Exploring CLIP for Assessing the Look and Feel of Images"): the probability that an image
is nearer to the first text of a pair of antonyms than to the second. The image keeps its size, so the attention pool
goes without its positional embedding, which is for 224x224 only.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from bench.metrics.clip_prompts import PROMPT_PAIRS
from orca.conventions import Float32Array, UInt8Array
from orca.errors import BadInput

__all__ = ["MEAN", "STD", "ClipPairs", "open_clip_pairs", "pyiqa_pairs", "read_clip_state"]

# Mean and standard deviation of the images that OpenAI trained CLIP on.
MEAN, STD = (0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711)


class ClipPairs:
    """Probability of the better text of each of `PROMPT_PAIRS`.

    Args:
        encode_image: features [1, dim] of a normalised image [1, 3, H, W].
        encode_text: features [n, dim] of tokens [n, 77]; called once, here.
        tokens: tokens of the pairs, better text first, [2 * pairs, 77].
        logit_scale: CLIP's temperature, as a logarithm.
        device: where the network is.
    """

    def __init__(
        self,
        encode_image: Callable[[Tensor], Tensor],
        encode_text: Callable[[Tensor], Tensor],
        tokens: Tensor,
        logit_scale: Tensor,
        device: str,
    ) -> None:
        self._encode_image, self._device = encode_image, device
        self._mean, self._std = (torch.tensor(x, device=device).view(1, 3, 1, 1) for x in (MEAN, STD))
        with torch.inference_mode():
            text = encode_text(tokens.to(device))
            self._text = logit_scale.exp() * text / text.norm(dim=-1, keepdim=True)

    @torch.inference_mode()
    def __call__(self, frame: UInt8Array) -> Float32Array:
        """Probabilities, one a pair, of a frame [H, W, 3] uint8; may be called from several threads at once."""
        image = torch.from_numpy(frame.copy()).to(self._device).permute(2, 0, 1)[None].float() / 255
        features = self._encode_image((image - self._mean) / self._std)
        logits = features / features.norm(dim=-1, keepdim=True) @ self._text.T
        probabilities: Float32Array = logits.view(-1, 2).softmax(dim=-1)[:, 0].cpu().numpy()
        return probabilities


def pyiqa_pairs(state: dict[str, Tensor], device: str) -> ClipPairs:
    """CLIP as pyiqa builds it from an OpenAI state dict (which may keep some weights in half precision)."""
    from pyiqa.archs.clip_imports import clip
    from pyiqa.archs.clip_model import build_model

    model = build_model(dict(state)).float().to(device)
    return ClipPairs(
        lambda image: model.encode_image(image, pos_embedding=False),
        model.encode_text,
        clip.tokenize(_texts()),
        model.logit_scale,
        device,
    )


def open_clip_pairs(state: dict[str, Tensor], device: str) -> ClipPairs:
    """CLIP as open_clip builds it from the same state dict, with OpenAI's QuickGELU; uses nothing of pyiqa."""
    import open_clip
    from open_clip.model import build_model_from_openai_state_dict

    model: Any = build_model_from_openai_state_dict(dict(state), cast_dtype=torch.float32).float()
    pool = model.visual.attnpool
    # One row of zeros is added to every position: no positional embedding, at any size.
    pool.positional_embedding = torch.nn.Parameter(torch.zeros_like(pool.positional_embedding[:1]))
    model = model.to(device)
    return ClipPairs(model.encode_image, model.encode_text, open_clip.tokenize(_texts()), model.logit_scale, device)


def read_clip_state(path: Path) -> dict[str, Tensor]:
    """The state dict inside OpenAI's TorchScript archive; such an archive holds code: check its hash first.

    Raises:
        BadInput: the file is no such archive.
    """
    try:
        archive = torch.jit.load(str(path), map_location="cpu")  # type: ignore[no-untyped-call]
        state: dict[str, Tensor] = archive.state_dict()
    except (RuntimeError, ValueError, OSError, pickle.UnpicklingError) as error:
        raise BadInput(
            f"the CLIP weights {path} cannot be read ({type(error).__name__}: {str(error)[:200]})",
            "OpenAI's RN50.pt, a TorchScript archive",
            "get the published file again",
        ) from error
    return state


def _texts() -> list[str]:
    return [text for pair in PROMPT_PAIRS for text in pair]
