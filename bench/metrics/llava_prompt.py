"""LLaVA-IQA as VistaDream asks it: model, five questions, prompt and the reading of an answer."""

from __future__ import annotations

import re

__all__ = ["LLAVA_MODEL", "LLAVA_QUESTIONS", "NEW_TOKENS", "chat_text", "full_prompt", "said_yes"]

LLAVA_MODEL = "llava-hf/bakLlava-v1-hf"
NEW_TOKENS = 200

# Word for word, with its spelling.
LLAVA_QUESTIONS = {
    "noise_free": "Is the image free of noise or distortion",
    "edge": "Does the image show clear objects and sharp edges",
    "structure": "Is the overall scene coherent and realistic in terms of layout and proportions in this image",
    "detail": "Does this image show detailed textures and materials",
    "quality": (
        "Is this image overall a high quality image with clear objects, sharp edges, nice color, "
        "good overall structure, and good visual quailty"
    ),
}


def chat_text(question: str) -> str:
    """What the user says: all of the prompt that an endpoint gets, since it adds its own chat template."""
    return f"{question}, just anwser with yes or no?"


def full_prompt(question: str) -> str:
    """The whole prompt of the local model, with the mark where the image goes."""
    return f"<image>\n USER: {chat_text(question)} \n ASSISTANT: "


def said_yes(answer: str) -> bool | None:
    """Whether an answer means yes, or no; None for anything else.

    As VistaDream reads it: the text after the last "ASSISTANT:" starts with "yes", in any case. No is the whole word,
    so that "not sure" and "nothing" are neither.
    """
    text = answer.rpartition("ASSISTANT:")[2].strip().lower()
    if text.startswith("yes"):
        return True
    return False if re.match(r"no\b", text) else None
