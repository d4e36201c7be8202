"""A weights folder for every metric that needs one: random numbers in the form of the published files."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from bench.metrics import clip_iqa, llava_local
from bench.metrics.llava import BAKLLAVA
from bench.metrics.lpips import LPIPS_ALEX, LPIPS_VGG
from bench.metrics.musiq import MUSIQ_KONIQ
from tests.bench.learned_weights import clip_state, musiq_metric
from tests.bench.test_clip_iqa import save_archive
from tests.bench.test_llava import save_tiny_llava
from tests.bench.test_lpips import write_weights
from tests.bench.test_niqe import write_prior

__all__ = ["write_all_weights"]


def write_all_weights(folder: Path, patch: pytest.MonkeyPatch) -> None:
    """Write them; CLIP's, which is read only where it is the published file, is pinned anew through ``patch``."""
    write_prior(folder)
    torch.save({"params": musiq_metric().net.state_dict()}, folder / MUSIQ_KONIQ.name)
    for kind in (LPIPS_ALEX, LPIPS_VGG):
        write_weights(folder, kind)
    archive = folder / clip_iqa.CLIP_RN50.name
    save_archive(clip_state(), archive)
    digest = hashlib.sha256(archive.read_bytes()).hexdigest()
    patch.setattr(clip_iqa, "CLIP_RN50", replace(clip_iqa.CLIP_RN50, expected_sha256=digest))
    save_tiny_llava(folder / BAKLLAVA.name, says="Yes")
    patch.setattr(llava_local, "NEW_TOKENS", 2)  # it would say the same word two hundred times
