"""`auto`: the best prior that is here, and why not a better one."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orca import cli
from orca.camera import Camera
from orca.config import get_preset
from orca.errors import BadInput, Unavailable, Unknown
from orca.priors.auto import AutoDepth
from orca.priors.choose import (
    INPAINTER_CHOICES,
    OUTPAINTER_CHOICES,
    Priors,
    choose_depth_estimator,
    choose_inpainter,
    choose_outpainter,
)
from orca.priors.depth import DepthEstimate, parse_depth_spec
from orca.priors.hub import DEPTH_ANYTHING_V2_SMALL, DEPTH_PRO, SD15_INPAINTING, HubModel, ModelAccess
from orca.priors.learned import DepthAnythingDepth, DepthProDepth
from tests.orca.tiny_onnx import write_channel_mixer

H, W = 20, 32
IMAGE = np.random.default_rng(1).random((H, W, 3), dtype=np.float32)
CAMERA = Camera.from_fov(W, H, 60)


def pretend(weights_dir: Path, *models: HubModel) -> ModelAccess:
    """A weights folder that has every file of these models, empty."""
    for model in models:
        for name in model.files:
            path = weights_dir / model.repo / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
    return ModelAccess(weights_dir)


@pytest.fixture
def answers(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the two networks do when they are asked, by name: a depth, or an error to raise."""
    given: dict[str, Any] = {}

    def fake(self: Any, image: np.ndarray, camera: Camera) -> DepthEstimate:
        answer = given.get(self.name, Unavailable(f"{self.name} has no weights", "", ""))
        if isinstance(answer, Exception):
            raise answer
        return DepthEstimate(np.full(image.shape[:2], answer, np.float32), self.name, True)

    monkeypatch.setattr(DepthProDepth, "estimate", fake)
    monkeypatch.setattr(DepthAnythingDepth, "estimate", fake)
    return given


@pytest.mark.parametrize(
    ("here", "source", "skipped"),
    [
        ({"depth-pro": 2.0, "depth-anything": 3.0}, "depth-pro", []),
        ({"depth-anything": 3.0}, "depth-anything", ["depth-pro"]),
        ({}, "heuristic (no network)", ["depth-pro", "depth-anything"]),
        ({"depth-pro": MemoryError("too big"), "depth-anything": 3.0}, "depth-anything", ["depth-pro"]),
        ({"depth-pro": RuntimeError("CUDA out\nof memory")}, "heuristic (no network)", ["depth-pro", "depth-anything"]),
    ],
)
def test_order_and_reasons(answers: dict[str, Any], here: dict[str, Any], source: str, skipped: list[str]) -> None:
    answers.update(here)
    result = parse_depth_spec("auto").estimate(IMAGE, CAMERA)
    assert result.source == source
    said = [note.partition(" did not run: ")[0] for note in result.notes if "did not run" in note]
    assert said == skipped
    if isinstance(here.get("depth-pro"), MemoryError):
        assert "too big" in result.notes[0]


def test_a_network_of_the_users_comes_before_the_guess(answers: dict[str, Any], tmp_path: Path) -> None:
    write_channel_mixer(tmp_path / "n.onnx", (1.0, 0.5, 0.25))
    spec = f"auto:{tmp_path / 'n.onnx'}?size=8&range=1&meaning=depth"
    provider = parse_depth_spec(spec)
    result = provider.estimate(IMAGE, CAMERA)
    assert result.source == "onnx n.onnx"
    assert len(result.notes) == 2
    answers["depth-anything"] = 3.0
    assert parse_depth_spec(spec).estimate(IMAGE, CAMERA).source == "depth-anything"
    assert provider.estimate(IMAGE, CAMERA).source == "onnx n.onnx"  # the first answer stands for the whole run


def test_wrong_options_are_said_before_anything_is_tried() -> None:
    with pytest.raises(BadInput, match="without range"):
        parse_depth_spec("auto:n.onnx?size=9")
    with pytest.raises(Unknown, match="no option"):
        parse_depth_spec("auto?size=9")


def test_whoever_guessed_estimates_no_depth_of_a_completed_crop(answers: dict[str, Any], tmp_path: Path) -> None:
    provider = parse_depth_spec("auto", ModelAccess(tmp_path))
    assert isinstance(provider, AutoDepth)
    assert Priors().using(provider).depth is None  # it has not run yet
    provider.estimate(IMAGE, CAMERA)
    assert Priors().using(provider).depth is None
    answers["depth-pro"] = 2.0
    good = parse_depth_spec("auto", ModelAccess(tmp_path))
    good.estimate(IMAGE, CAMERA)
    assert isinstance(Priors().using(good).depth, DepthProDepth)


@pytest.mark.parametrize("spec", ["file:d.npy", "heuristic", "constant"])
def test_files_and_guesses_estimate_nothing_new(spec: str, tmp_path: Path) -> None:
    assert Priors().using(parse_depth_spec(spec)).depth is None
    known = DepthProDepth()
    assert Priors(depth=known).using(parse_depth_spec(spec)).depth is known


def test_without_a_network_the_note_says_which_were_looked_for(tmp_path: Path) -> None:
    estimator, note = choose_depth_estimator(ModelAccess(tmp_path))
    assert estimator is None
    assert "Depth Pro" in note
    assert "Depth Anything V2 Small" in note


def test_depth_estimators_by_what_is_here(tmp_path: Path) -> None:
    access = pretend(tmp_path, DEPTH_ANYTHING_V2_SMALL)
    assert isinstance(choose_depth_estimator(access)[0], DepthAnythingDepth)
    assert isinstance(choose_depth_estimator(pretend(tmp_path, DEPTH_PRO))[0], DepthProDepth)


def test_in_and_outpainter_by_what_is_here(tmp_path: Path) -> None:
    empty, full = ModelAccess(tmp_path / "no"), pretend(tmp_path / "yes", SD15_INPAINTING)
    for choose, without in ((choose_inpainter, "classical"), (choose_outpainter, "mean")):
        chosen, note = choose("auto", empty)
        assert chosen is not None
        assert (chosen.name, "unet/config.json" in note) == (without, True)
        chosen, note = choose("auto", full)
        assert chosen is not None
        assert (chosen.name, note) == ("sd15", "")
        assert choose("none", empty) == (None, "")
        with pytest.raises(Unavailable, match="vae/config"):
            choose("sd15", empty)
        with pytest.raises(Unknown, match="did you mean 'classical'"):
            choose("clasical", empty)


def test_every_choice_of_the_command_line_is_a_name() -> None:
    assert cli.INPAINTERS == INPAINTER_CHOICES
    assert cli.OUTPAINTERS == OUTPAINTER_CHOICES


def test_the_record_names_everyone(tmp_path: Path) -> None:
    priors = Priors.of(get_preset("draft"), ModelAccess(tmp_path), seed=3)
    record = priors.to_json()
    assert (record["outpainter"], record["inpainter"], record["depth"]) == ("mean", "classical", "none")
    assert len(record["notes"]) == 2  # why no Stable Diffusion, why no depth network
    assert Priors().to_json()["inpainter"] == "none"


def test_auto_without_weights_needs_no_network(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("socket.create_connection", lambda *_, **__: pytest.fail("connected"))
    with caplog.at_level(logging.WARNING):
        result = parse_depth_spec("auto", ModelAccess(tmp_path)).estimate(IMAGE, CAMERA)
    assert result.source == "heuristic (no network)"
    assert "guessed" in caplog.text
    assert sum("did not run" in note for note in result.notes) == 2
