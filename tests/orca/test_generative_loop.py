"""Generative repair inside stage 3: the budget, the ledger, and a finished scene whatever fails."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from orca.anchors import Stage
from orca.camera import Camera
from orca.config import ReconstructConfig
from orca.pipeline import Reconstruction, reconstruct
from orca.priors.choose import Priors
from orca.priors.depth import DepthEstimate
from orca.priors.diffusion import DiffusionInpainter
from orca.priors.diffusion_config import DiffusionConfig
from orca.priors.exemplar import ExemplarInpainter
from orca.priors.hub import ModelAccess
from orca.repair.ledger import Ledger
from tests.orca.repair_scenes import FAR, SIZE, estimate, input_camera, picture, sideways, small_config
from tests.orca.test_generative import DEPTHERS, PAINTERS, Painter, orange
from tests.orca.tiny_models import write_stable_diffusion

CAMERAS = sideways(0.12)


class FarWall:
    """Estimates the wall behind the square, tilted a little so that there is something to fit."""

    name = "far-wall"

    def __init__(self, answer: Callable[[np.ndarray], Any] = lambda z: z) -> None:
        self.answer, self.calls = answer, 0

    @classmethod
    def from_spec(cls, spec: Any) -> FarWall:
        raise NotImplementedError

    def estimate(self, image: np.ndarray, camera: Camera) -> DepthEstimate:
        self.calls += 1
        x = (np.arange(camera.width) + 0.5 - camera.K[0, 2]) / camera.K[0, 0]
        z = np.tile(FAR + TILT * x, (camera.height, 1)).astype(np.float32)
        return DepthEstimate(np.asarray(self.answer(z), np.float32), "test", True)


TILT = 2.0  # of the wall, in depth per unit of image tangent


def config(budget: int = 2, inpainter: str = "none") -> ReconstructConfig:
    """Every component is large and compact enough."""
    small = small_config()
    rules = replace(
        small.repair.rules,
        generative_min_area=1,
        generative_min_fill=0.0,
        generative_min_side=1,
        generative_budget=budget,
        max_iterations=8,
    )
    generative = replace(small.repair.generative, context=160)  # 20 pixels at this size
    repair = replace(small.repair, rules=rules, inpainter=inpainter, generative=generative)
    return replace(small, repair=repair, canvas=replace(small.canvas, outpainter="none"))


def finished(priors: Priors, budget: int = 2, cameras: tuple[Camera, ...] = CAMERAS) -> Reconstruction:
    """The whole method on the small scene; the wall is tilted."""
    image, depth = picture()
    x = (np.arange(SIZE) + 0.5 - SIZE / 2) / input_camera().K[0, 0]
    depth = np.where(depth == FAR, FAR + TILT * x, depth).astype(np.float32)
    return reconstruct(image, input_camera(), estimate(depth), cameras, config(budget), priors=priors)


def rows(result: Reconstruction, decision: str) -> list[dict[str, Any]]:
    return [row for row in result.ledger["repairs"] if row["decision"] == decision]


def test_at_most_the_budget_and_the_rest_locally() -> None:
    painter, depth = Painter(orange), FarWall()
    result = finished(Priors(inpainter=painter, depth=depth), budget=1)
    made = rows(result, "generative")
    assert len(made) == len(painter.seen) == depth.calls == 1
    assert rows(result, "local")
    for row in made:
        assert row["rule"] == "all_hold"
        assert row["scheme"] == "generative:painter+far-wall"
        assert row["alignment"]["inlier_share"] >= 0.5
        assert row["alignment"]["a"] > 0
    later = rows(result, "local")[-1]
    assert later["rule"] == "generative_budget"
    assert later["alignment"] is None
    assert Ledger.from_json(json.loads(json.dumps(result.ledger))).to_json() == result.ledger


def test_what_was_painted_is_what_the_hole_shows() -> None:
    result = finished(Priors(inpainter=Painter(orange)))
    row = rows(result, "generative")[0]
    x0, y0, x1, y1 = row["bbox"]
    view = result.scene.renderer().render(CAMERAS[row["view"]])
    middle = view.rgb[(y0 + y1) // 2 - 2 : (y0 + y1) // 2 + 2, (x0 + x1) // 2]
    assert row["coverage_after"] > 0.9
    assert np.abs(np.median(middle, axis=0) - [0.9, 0.5, 0.1]).max() < 0.15
    before = finished(Priors(), 0).record["input_psnr"]["final"]
    assert result.record["input_psnr"]["final"] > before - 0.05


def test_a_budget_of_none_asks_nobody() -> None:
    painter = Painter(orange)
    result = finished(Priors(inpainter=painter), budget=0)
    assert painter.seen == []
    assert {row["rule"] for row in result.ledger["repairs"]} == {"generative_budget"}


def test_without_an_inpainter_the_ledger_says_so() -> None:
    result = finished(Priors())
    assert {row["rule"] for row in result.ledger["repairs"]} == {"no_inpainter"}
    assert result.record["priors"]["inpainter"] == "none"


@pytest.mark.parametrize("name", PAINTERS)
def test_whatever_the_inpainter_does_the_scene_is_finished(name: str) -> None:
    paint, words = PAINTERS[name]
    painter = Painter(paint)
    result = finished(Priors(inpainter=painter, depth=FarWall()))
    assert rows(result, "generative") == []
    failed = [row for row in result.ledger["repairs"] if row["rule"] == "generative_failed"]
    assert len(failed) == len(painter.seen) == 2  # the budget counts what was tried
    assert all(words in row["reason"] and "repaired locally because" in row["reason"] for row in failed)
    same_as_local(result)


@pytest.mark.parametrize("name", DEPTHERS)
def test_whatever_the_depth_does_the_scene_is_finished(name: str) -> None:
    answer, words = DEPTHERS[name]
    result = finished(Priors(inpainter=Painter(orange), depth=FarWall(answer)))
    assert rows(result, "generative") == []
    failed = [row for row in result.ledger["repairs"] if row["rule"] == "generative_failed"]
    assert len(failed) == 2
    assert all(words.replace("scale of -", "depth") in row["reason"] for row in failed)
    same_as_local(result)


def same_as_local(result: Reconstruction) -> None:
    """A fall-back leaves exactly the scene that no inpainter at all leaves."""
    other = finished(Priors())
    assert torch.equal(result.scene.anchors.means, other.scene.anchors.means)
    assert torch.equal(result.scene.anchors.features, other.scene.anchors.features)


def turned(degrees: float) -> Camera:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    pose = np.eye(4)
    pose[:3, :3] = [[c, 0, -s], [0, 1, 0], [s, 0, c]]
    return Camera.from_fov(SIZE, SIZE, 60, pose)


@pytest.mark.parametrize("degrees", [30.0, 57.0, 120.0])
def test_a_hole_at_the_border_or_all_over(degrees: float) -> None:
    """Half a view, nearly all of it, and all of it; nothing is outpainted."""
    result = finished(Priors(inpainter=ExemplarInpainter()), cameras=(input_camera(), turned(degrees)))
    assert result.ledger["stopped"]
    view = result.scene.renderer().render(turned(degrees))
    assert np.isfinite(view.rgb).all()
    made = [row for row in result.ledger["repairs"] if row["view"] == 1]
    if degrees == 120.0:
        assert made == []  # a view that sees nothing of the scene has nothing to be repaired from
        return
    tried = [row for row in made if row["rule"] in ("all_hold", "generative_failed")]
    assert tried
    assert tried[0]["bbox"][2] == SIZE
    if degrees == 30.0:
        assert tried[0]["decision"] == "generative"
        assert tried[0]["coverage_after"] > tried[0]["coverage_before"] + 0.3


def test_the_classical_inpainter_under_the_same_protocol() -> None:
    result = finished(Priors(inpainter=ExemplarInpainter(seed=1)))
    made = rows(result, "generative")
    assert made
    assert made[0]["scheme"] == "generative:classical+continued"
    again = finished(Priors(inpainter=ExemplarInpainter(seed=1)))
    assert torch.equal(again.scene.anchors.means, result.scene.anchors.means)
    assert torch.equal(again.scene.anchors.features, result.scene.anchors.features)
    assert int((result.scene.anchors.stage == int(Stage.REPAIRED)).sum()) > 50


@pytest.mark.slow
def test_the_real_pipeline_completes_a_hole(tmp_path: Path) -> None:
    """Stable Diffusion's own classes, tiny, from a weights folder into the scene's anchors."""
    write_stable_diffusion(tmp_path)
    inpainter = DiffusionInpainter(ModelAccess(tmp_path), DiffusionConfig(steps=2, side=64))
    made = rows(finished(Priors(inpainter=inpainter)), "generative")
    assert made
    assert made[0]["scheme"] == "generative:sd15+continued"
    assert made[0]["anchors_added"] > 50
    assert made[0]["coverage_after"] > 0.9
