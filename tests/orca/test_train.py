"""Gradient training: it learns, repeats itself, leaves the means alone, stops early and bakes what it learned."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from orca.anchors import GaussianAnchors
from orca.config import HashConfig, PlacementConfig, PlanarConfig, RenderConfig, TrainConfig
from orca.field.decoders import Decoders
from orca.field.hashing import HashEncoding
from orca.render.renderer import Renderer
from orca.stages.observations import Observation, observations
from orca.stages.planar import place, planar_anchors, rest_positions
from orca.stages.train import TrainPlan, TrainResult, train
from tests.orca.stage_inputs import bare_canvas, picture, psnr

PER_HIT = RenderConfig(decode="per_hit", window=2)
LAYERED = RenderConfig()
FROZEN = TrainPlan(max_iterations=8, arm_after=0, train_means=False, train_extents=False)
FREE = replace(FROZEN, train_means=True, train_extents=True)
SHORT = TrainConfig(batch_rays=128, eval_every=4)


@dataclass(frozen=True)
class Problem:
    """Everything that training starts from, at its random initialisation."""

    anchors: GaussianAnchors
    decoders: Decoders
    encoding: HashEncoding
    observed: tuple[Observation, ...]
    generator: torch.Generator

    def train(
        self,
        plan: TrainPlan,
        config: TrainConfig = SHORT,
        render: RenderConfig = PER_HIT,
        progress: Callable[[int, int], None] = lambda done, total: None,
    ) -> TrainResult:
        return train(
            self.anchors, self.decoders, self.encoding, self.observed, plan, config, render, self.generator, progress
        )

    def psnr(self, anchors: GaussianAnchors, render: RenderConfig = PER_HIT) -> float:
        first = self.observed[0]
        rgb = Renderer(anchors, self.decoders, render).render(first.camera).rgb
        return psnr(rgb.reshape(-1, 3)[first.rays], first.colour)


def problem(seed: int = 0, size: int = 32, per_pixel: float = 1.0, residual: float = 0.0) -> Problem:
    """A picture to learn; ``residual`` scales what the anchors carry besides the encoding."""
    canvas = bare_canvas(picture(size, size))
    config = PlanarConfig(placement=PlacementConfig(kind="grid"), anchors_per_pixel=per_pixel, opacity_logit=1.0)
    generator = torch.Generator().manual_seed(seed)
    grid = place(canvas, config)
    hashing = HashConfig(log2_table_size=12, finest_resolution=256)
    encoding = HashEncoding(rest_positions(canvas, grid), hashing, generator)
    decoders = Decoders(generator=generator)
    anchors = planar_anchors(canvas, grid, config)
    carried = residual * torch.rand(anchors.features.shape, generator=generator)
    anchors = anchors.with_features(carried + encoding().detach())
    return Problem(anchors, decoders, encoding, observations(canvas, 4.0), generator)


@pytest.mark.slow
def test_training_from_random_initialisation_learns_the_picture() -> None:
    start = problem()
    before = start.psnr(start.anchors)
    config = TrainConfig(batch_rays=256, eval_every=50, lr_field_final=5e-3)
    result = start.train(replace(FROZEN, max_iterations=100), config)
    colour = start.observed[0].colour
    flat = psnr(np.broadcast_to(colour.mean(0), colour.shape), colour)
    assert result.iterations == 100
    assert result.stopped == "max_iterations"
    after = start.psnr(result.anchors)
    assert after > before + 3
    assert after > flat + 3  # more than the picture's mean colour
    # Trained against random backgrounds, it is opaque.
    assert Renderer(result.anchors, start.decoders, PER_HIT).render(start.observed[0].camera).alpha.mean() > 0.9


@pytest.mark.parametrize("render", [PER_HIT, LAYERED], ids=["per hit", "layered"])
def test_both_decodings_train_and_leave_what_the_trainer_saw(render: RenderConfig) -> None:
    """The baked features include the encoding: rendering the result gives the PSNR of the last evaluation."""
    start = problem(size=20)
    before = start.psnr(start.anchors, render)
    config = replace(SHORT, lr_field_final=1e-2)
    result = start.train(replace(FROZEN, max_iterations=24), config, render)
    assert [step for step, *_ in result.history] == [4, 8, 12, 16, 20, 24]
    assert start.psnr(result.anchors, render) == pytest.approx(result.history[-1][1], abs=1e-4)
    assert result.history[-1][1] > before + 0.3
    for tensor in vars(result.anchors).values():
        assert not tensor.requires_grad
        assert torch.isfinite(tensor).all()


def test_what_anchors_carry_besides_the_encoding_is_kept() -> None:
    start = problem(size=16, residual=0.3)
    carried = start.anchors.features - start.encoding().detach()
    at_first = start.encoding().detach().clone()
    result = start.train(FROZEN)
    now = start.encoding().detach()
    assert float((now - at_first).abs().max()) > 1e-3
    torch.testing.assert_close(result.anchors.features - now, carried, atol=1e-6, rtol=0)


@pytest.mark.parametrize("plan", [FROZEN, FREE], ids=["frozen", "free"])
def test_a_seed_gives_the_same_anchors_bit_for_bit(plan: TrainPlan) -> None:
    first, second, other = (problem(seed, size=16).train(plan) for seed in (3, 3, 4))
    assert first.history == second.history
    for name, tensor in vars(first.anchors).items():
        assert torch.equal(tensor, getattr(second.anchors, name)), name
    assert not torch.are_deterministic_algorithms_enabled()  # the caller's setting is left alone
    assert not torch.equal(first.anchors.features, other.anchors.features)


def test_frozen_geometry_is_bit_identical() -> None:
    start = problem(size=16)
    result = start.train(FROZEN)
    for name in ("means", "log_variances", "quaternions", "stage"):
        assert torch.equal(getattr(result.anchors, name), getattr(start.anchors, name)), name
    for name in ("opacity_logits", "features"):
        assert not torch.equal(getattr(result.anchors, name), getattr(start.anchors, name)), name


def test_stage_2_trains_everything_but_the_means() -> None:
    start = problem(size=16)
    result = start.train(replace(FROZEN, train_extents=True))
    assert torch.equal(result.anchors.means, start.anchors.means)
    assert not torch.equal(result.anchors.log_variances, start.anchors.log_variances)
    assert not torch.equal(result.anchors.quaternions, start.anchors.quaternions)


def test_free_geometry_moves_at_its_own_rates() -> None:
    start = problem(size=16)
    result = start.train(FREE)
    steps = FREE.max_iterations
    for name, rate in (("means", 1e-5), ("log_variances", 5e-5), ("quaternions", 1e-3), ("opacity_logits", 1e-3)):
        moved = (getattr(result.anchors, name) - getattr(start.anchors, name)).abs().max().item()
        assert 0 < moved <= 1.5 * rate * steps, name


def test_the_decoders_and_the_encoding_are_trained_in_place() -> None:
    start = problem(size=16)
    weights = [p.detach().clone() for p in (*start.decoders.parameters(), *start.encoding.parameters())]
    start.train(FROZEN)
    now = [*start.decoders.parameters(), *start.encoding.parameters()]
    assert sum(not torch.equal(a, b) for a, b in zip(weights, now, strict=True)) == len(weights)


def test_early_stopping_ends_a_run_that_does_not_gain() -> None:
    plan = replace(FROZEN, max_iterations=50)
    config = TrainConfig(batch_rays=32, eval_every=2, min_gain_db=1e3, patience=3)
    result = problem(size=16).train(plan, config)
    assert (result.stopped, result.iterations) == ("early_stopping", 8)  # the first sets the best, three wait
    armed = problem(size=16).train(replace(plan, arm_after=6), config)
    assert (armed.stopped, armed.iterations) == ("early_stopping", 12)
    assert [step for step, *_ in armed.history] == [2, 4, 6, 8, 10, 12]


def test_no_iterations_change_nothing() -> None:
    start = problem(size=16)
    result = start.train(replace(FROZEN, max_iterations=0))
    assert (result.iterations, result.history) == (0, ())
    torch.testing.assert_close(result.anchors.features, start.anchors.features, atol=1e-8, rtol=0)


def test_progress_is_reported_every_step() -> None:
    seen: list[tuple[int, int]] = []
    problem(size=16).train(FROZEN, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(i, 8) for i in range(1, 9)]


def test_the_margin_takes_part_and_the_original_decides_when_to_stop() -> None:
    """Two observations of one picture: batches are shared out by size, and the first one is evaluated."""
    start = problem(size=16)
    whole = start.observed[0]
    half = Observation(whole.camera, whole.rays[:128], whole.colour[:128])
    rest = Observation(whole.camera, whole.rays[128:], whole.colour[128:])
    both = replace(start, observed=(half, rest))
    result = both.train(FROZEN)
    assert both.psnr(result.anchors) == pytest.approx(result.history[-1][1], abs=1e-4)
    alone = replace(problem(size=16), observed=(half,))
    assert not torch.equal(alone.train(FROZEN).anchors.features, result.anchors.features)
