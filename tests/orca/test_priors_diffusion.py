"""Stable Diffusion inpainting: the real pipeline, tiny, with tokenizer, scheduler, autoencoder and U-Net."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orca.errors import BadInput, Unavailable
from orca.priors.diffusion import DiffusionInpainter, _network_size
from orca.priors.diffusion_config import DiffusionConfig
from orca.priors.grow import DiffusionOutpainter
from orca.priors.hub import SD15_INPAINTING, ModelAccess
from orca.priors.inpaint import InpaintFailed
from tests.orca.tiny_models import write_stable_diffusion

pytestmark = pytest.mark.slow  # importing the models' libraries takes longer than the tests

FAST = DiffusionConfig(steps=3, side=64)


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("weights")
    write_stable_diffusion(folder)
    return folder


@pytest.fixture(scope="module")
def inpainter(weights: Path) -> DiffusionInpainter:
    return DiffusionInpainter(ModelAccess(weights), FAST)


def picture(height: int = 50, width: int = 90) -> tuple[np.ndarray, np.ndarray]:
    image = np.random.default_rng(0).random((height, width, 3), dtype=np.float32)
    mask = np.zeros((height, width), bool)
    mask[10:30, 20:60] = True
    return image, mask


def spy(monkeypatch: pytest.MonkeyPatch, inpainter: DiffusionInpainter) -> dict[str, Any]:
    """The arguments of the next call of the pipeline, which still runs."""
    seen: dict[str, Any] = {}
    pipeline = inpainter.load()

    def call(**given: Any) -> Any:
        seen.update(given)
        return pipeline(**given)

    monkeypatch.setattr(inpainter, "_pipeline", call)
    return seen


def test_paper_constants_are_the_defaults() -> None:
    assert (DiffusionConfig().steps, DiffusionConfig().guidance, DiffusionConfig().side) == (30, 7.0, 512)


def test_only_the_hole_changes_and_one_seed_gives_one_picture(inpainter: DiffusionInpainter, weights: Path) -> None:
    image, mask = picture()
    result = inpainter.inpaint(image, mask)
    assert result.dtype == np.float32
    np.testing.assert_array_equal(result[~mask], image[~mask])
    assert result[mask].std() > 0.01
    assert 0 <= result.min() <= result.max() <= 1
    again = DiffusionInpainter(ModelAccess(weights), FAST).inpaint(image, mask)
    np.testing.assert_array_equal(again, result)
    other = DiffusionInpainter(ModelAccess(weights), FAST, seed=1)
    other._pipeline = inpainter.load()
    assert not np.array_equal(other.inpaint(image, mask), result)


def test_what_lies_under_the_mask_is_never_seen(inpainter: DiffusionInpainter) -> None:
    image, mask = picture()
    result = inpainter.inpaint(image, mask)
    image[mask] = np.nan
    np.testing.assert_array_equal(inpainter.inpaint(image, mask), result)


def test_the_network_gets_the_papers_settings(inpainter: DiffusionInpainter, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = spy(monkeypatch, inpainter)
    image, mask = picture()
    inpainter.inpaint(image, mask)
    assert (seen["num_inference_steps"], seen["guidance_scale"]) == (3, 7.0)
    assert (seen["width"], seen["height"]) == (64, 32)  # 90x50 at 64 a side, in multiples of 8
    assert tuple(seen["image"].shape) == (1, 3, 32, 64)
    hole = seen["mask_image"].numpy()[0, 0] > 0.5
    assert abs(hole.mean() - mask.mean()) < 0.05
    assert hole.mean() >= mask.mean()  # a network pixel that is partly unknown is unknown
    assert seen["prompt"] == FAST.prompt


@pytest.mark.parametrize(
    ("width", "height", "expected"),
    [(512, 512, (512, 512)), (300, 200, (512, 344)), (1280, 980, (512, 392)), (2000, 10, (512, 8)), (8, 8, (512, 512))],
)
def test_network_size_by_hand(width: int, height: int, expected: tuple[int, int]) -> None:
    assert _network_size(width, height, 512) == expected


def test_the_pipeline_loads_with_the_hubs_files_only(weights: Path, inpainter: DiffusionInpainter) -> None:
    assert SD15_INPAINTING.missing_in(weights / SD15_INPAINTING.repo) == []
    pipeline = inpainter.load()
    assert type(pipeline).__name__ == "StableDiffusionInpaintPipeline"
    assert pipeline.unet.config.in_channels == 9
    assert pipeline.safety_checker is None
    assert str(pipeline.unet.dtype) == "torch.float32"


@pytest.mark.parametrize("name", SD15_INPAINTING.files)
def test_each_missing_file_is_named(weights: Path, tmp_path: Path, name: str) -> None:
    folder = tmp_path / SD15_INPAINTING.repo
    shutil.copytree(weights / SD15_INPAINTING.repo, folder)
    (folder / name).unlink()
    with pytest.raises(Unavailable, match=name.replace(".", r"\.")):
        DiffusionInpainter(ModelAccess(tmp_path)).inpaint(*picture())


def test_files_that_are_no_pipeline_are_bad_input(weights: Path, tmp_path: Path) -> None:
    folder = tmp_path / SD15_INPAINTING.repo
    shutil.copytree(weights / SD15_INPAINTING.repo, folder)
    config = json.loads((folder / "unet" / "config.json").read_text())
    (folder / "unet" / "config.json").write_text(json.dumps({**config, "block_out_channels": [4, 8]}))
    with pytest.raises(BadInput, match="does not load"):
        DiffusionInpainter(ModelAccess(tmp_path)).load()


@pytest.mark.parametrize("error", [RuntimeError("out of memory"), MemoryError("no"), ValueError("bad")])
def test_a_pipeline_that_fails_is_typed(
    inpainter: DiffusionInpainter, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(**_: Any) -> None:
        raise error

    monkeypatch.setattr(inpainter, "_pipeline", fail)
    with pytest.raises(InpaintFailed, match=type(error).__name__):
        inpainter.inpaint(*picture())


def test_an_empty_mask_asks_nobody() -> None:
    image, mask = picture()
    result = DiffusionInpainter(ModelAccess(Path("nowhere"))).inpaint(image, np.zeros_like(mask))
    np.testing.assert_array_equal(result, image)
    assert result is not image


@pytest.mark.parametrize("change", [{"steps": 0}, {"side": 4}, {"guidance": -1.0}, {"guidance": float("nan")}])
def test_constants_out_of_range_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(BadInput, match="diffusion with"):
        DiffusionConfig(**change)


def test_outpainting_runs_tile_by_tile(inpainter: DiffusionInpainter, monkeypatch: pytest.MonkeyPatch) -> None:
    outpainter = DiffusionOutpainter(inpainter.access, FAST)
    object.__setattr__(outpainter, "inpainter", inpainter)
    image, _ = picture(40, 40)
    canvas = outpainter.outpaint(image, 30, 0, 20, 10)
    assert canvas.shape == (50, 90, 3)
    np.testing.assert_array_equal(canvas[:40, 30:70], image)
    assert canvas[:, :30].std() > 0.01
    assert canvas[40:].std() > 0.01
