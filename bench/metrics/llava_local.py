"""LLaVA on this machine, through transformers: half precision, greedy, one question at a time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bench.metrics.llava_prompt import LLAVA_MODEL, NEW_TOKENS, full_prompt
from orca.conventions import UInt8Array
from orca.errors import BadInput, Unavailable

__all__ = ["LocalLlava"]


class LocalLlava:
    """The model of a folder.

    Args:
        folder: a LLaVA in transformers' layout: configuration, tokenizer, safetensors.
        device: where it runs.

    Raises:
        Unavailable: the package transformers is not installed.
        BadInput: the folder holds no LLaVA.
    """

    def __init__(self, folder: Path, device: str) -> None:
        try:
            import torch
            from transformers import LlavaForConditionalGeneration, LlavaProcessor
        except ImportError as error:
            raise Unavailable(
                f"LLaVA on this machine needs the package transformers ({error})",
                "transformers, or an endpoint",
                "pip install 'orca-nvs[models]', or give --llava-url and --llava-model",
            ) from error
        self._device, self._dtype = device, torch.float16
        here: dict[str, Any] = {"local_files_only": True}
        try:
            self._processor = LlavaProcessor.from_pretrained(folder, **here)
            model = LlavaForConditionalGeneration.from_pretrained(
                folder, dtype=self._dtype, use_safetensors=True, low_cpu_mem_usage=True, **here
            )
        except (OSError, ValueError, KeyError, TypeError, RuntimeError, AttributeError, ImportError) as error:
            raise BadInput(
                f"{folder} cannot be read as a LLaVA ({type(error).__name__}: {str(error)[:200]})",
                f"the files of {LLAVA_MODEL}, weights as safetensors",
                f"get it again from https://huggingface.co/{LLAVA_MODEL}",
            ) from error
        self._model: Any = model.to(device).eval()

    def ask(self, frame: UInt8Array, question: str) -> str:
        """The answer to one of the questions about a frame [H, W, 3] uint8."""
        import torch
        from PIL import Image

        inputs = self._processor(images=Image.fromarray(frame), text=full_prompt(question), return_tensors="pt")
        inputs = inputs.to(self._device, self._dtype)
        with torch.inference_mode():
            tokens = self._model.generate(**inputs, max_new_tokens=NEW_TOKENS, do_sample=False)
        answer: str = self._processor.decode(tokens[0, inputs["input_ids"].shape[1] :], skip_special_tokens=True)
        return answer
