"""Ray-coherent aggregation over padded hits: windows, layers, hand-worked samples."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from orca.config import RenderConfig
from orca.render.aggregation import PaddedHits, aggregate, layer_index

LAYERED = RenderConfig(decode="layered")
WINDOW_2 = RenderConfig(decode="per_hit", window=2)
WHOLE_LAYER = RenderConfig(decode="per_hit", window=-1)


def _hits(
    t: list[float], m2: list[float], precision: list[float] | None = None, opacity: list[float] | None = None
) -> PaddedHits:
    """One ray whose features are one-hot, so that aggregated features are the weights themselves."""
    k = len(t)
    return PaddedHits(
        torch.ones(1, k, dtype=torch.bool),
        torch.tensor([t]),
        torch.tensor([m2]),
        torch.tensor([precision or [100.0] * k]),
        torch.eye(k)[None],
        torch.tensor([opacity or [1.0] * k]),
    )


def _random_hits(rays: int, k: int, seed: int, spread: float) -> PaddedHits:
    """Sorted random hits, some rays with fewer than k of them, within ``spread`` of depth 2."""
    g = torch.Generator().manual_seed(seed)
    count = torch.randint(1, k + 1, (rays,), generator=g)
    valid = torch.arange(k)[None] < count[:, None]
    t = (2 + spread * torch.rand(rays, k, generator=g)).masked_fill(~valid, 9.0).sort(1).values
    return PaddedHits(
        valid,
        t,
        (6.25 * torch.rand(rays, k, generator=g)).masked_fill(~valid, 0.0),
        (1 + 400 * torch.rand(rays, k, generator=g)).masked_fill(~valid, 1.0),
        torch.randn(rays, k, 8, generator=g),
        torch.rand(rays, k, generator=g),
    )


def test_one_layer_by_hand() -> None:
    """exp(-m2 / 2) = 1 and 1/3: weights 3/4 and 1/4, a^ = 3/4 * 1 * 0.8 + 1/4 * 1/3 * 0.6."""
    samples = aggregate(_hits([2.0, 2.02], [0.0, 2 * math.log(3)], opacity=[0.8, 0.6]), LAYERED)
    assert samples.valid.tolist() == [[True]]
    torch.testing.assert_close(samples.features, torch.tensor([[[0.75, 0.25]]]))
    torch.testing.assert_close(samples.t, torch.tensor([[0.75 * 2.0 + 0.25 * 2.02]]))
    torch.testing.assert_close(samples.opacity, torch.tensor([[0.75 * 0.8 + 0.25 * 0.6 / 3]]))


def test_two_hits_decoded_each_by_hand() -> None:
    """m2 = 0, a (t_2 - t_1)^2 = 2 ln 3: each hit weighs itself 3/4 and the other, which responds by 1/3, 1/4."""
    precision = 2 * math.log(3) / 0.01**2
    samples = aggregate(_hits([1.0, 1.01], [0.0, 0.0], [precision] * 2, [0.8, 0.6]), WINDOW_2)
    torch.testing.assert_close(samples.features, torch.tensor([[[0.75, 0.25], [0.25, 0.75]]]), rtol=1e-4, atol=1e-4)
    expected = torch.tensor([[0.75 * 0.8 + 0.25 * 0.6 / 3, 0.25 * 0.8 / 3 + 0.75 * 0.6]])
    torch.testing.assert_close(samples.opacity, expected, rtol=1e-4, atol=1e-4)
    assert samples.t.tolist() == [[1.0, pytest.approx(1.01)]]


def test_distances_use_the_members_own_precision() -> None:
    """D_kj has a_j, not a_k: the wide second anchor still reaches the first hit, but not the other way round."""
    samples = aggregate(_hits([1.0, 1.01], [0.0, 0.0], [1e9, 1e-3]), WINDOW_2)
    torch.testing.assert_close(samples.features, torch.tensor([[[0.5, 0.5], [0.0, 1.0]]]), rtol=0, atol=1e-5)


@pytest.mark.parametrize("window", [0, 1, 2, 3])
def test_a_window_reaches_that_many_hits_to_either_side(window: int) -> None:
    samples = aggregate(_hits([1.0] * 7, [0.5] * 7), replace(WINDOW_2, window=window))
    for k in range(7):
        inside = [j for j in range(7) if abs(j - k) <= window]
        weights = samples.features[0, k]
        assert weights.nonzero().ravel().tolist() == inside
        torch.testing.assert_close(weights[inside], torch.full((len(inside),), 1 / len(inside)))


def test_rays_of_three_hits_see_the_same_window_either_way() -> None:
    """On one layer of at most three hits, two neighbours on either side are everything there is."""
    hits = _random_hits(200, 3, 0, spread=0.03)
    assert int(layer_index(hits, LAYERED)[hits.valid].max()) == 0
    a, b = aggregate(hits, WINDOW_2), aggregate(hits, WHOLE_LAYER)
    for x, y in ((a.features, b.features), (a.opacity, b.opacity), (a.t, b.t)):
        torch.testing.assert_close(x[hits.valid], y[hits.valid])


def test_longer_rays_do_not() -> None:
    hits = _random_hits(200, 8, 0, spread=0.03)
    a, b = aggregate(hits, WINDOW_2), aggregate(hits, WHOLE_LAYER)
    assert (a.features - b.features)[hits.valid].abs().max() > 1e-2


@pytest.mark.parametrize("config", [LAYERED, WINDOW_2, WHOLE_LAYER, replace(WINDOW_2, window=0)])
def test_weights_sum_to_one(config: RenderConfig) -> None:
    hits = replace(_random_hits(300, 9, 1, spread=1.0), features=torch.ones(300, 9, 1))
    samples = aggregate(hits, config)
    sums = samples.features[..., 0]
    torch.testing.assert_close(sums[samples.valid], torch.ones(int(samples.valid.sum())))
    assert (sums[~samples.valid] == 0).logical_or(sums[~samples.valid].isclose(torch.ones(()))).all()
    assert (samples.opacity <= hits.opacity.max()).all()


def test_padding_has_no_influence() -> None:
    hits = _random_hits(100, 6, 2, spread=1.0)
    poisoned = replace(
        hits,
        features=torch.where(hits.valid[..., None], hits.features, 1e6),
        opacity=torch.where(hits.valid, hits.opacity, 1e6),
    )
    for config in (LAYERED, WINDOW_2, WHOLE_LAYER):
        clean, dirty = aggregate(hits, config), aggregate(poisoned, config)
        assert torch.equal(clean.valid, dirty.valid)
        torch.testing.assert_close(clean.features[clean.valid], dirty.features[clean.valid])
        torch.testing.assert_close(clean.opacity[clean.valid], dirty.opacity[clean.valid])


def test_layers_start_where_the_gap_is_wider_than_both_rules_allow() -> None:
    """Sigma 0.1 reaches 0.2 (two sigmas); 2 % of the depth reaches 0.02 at depth 1 and 0.2 at depth 10."""
    wide, thin = 100.0, 1e6
    cases = [
        ([1.0, 1.19], [wide, wide], [0, 0]),
        ([1.0, 1.21], [wide, wide], [0, 1]),
        ([1.0, 1.19], [thin, wide], [0, 0]),  # the larger sigma of the two counts
        ([1.0, 1.19], [wide, thin], [0, 0]),
        ([1.0, 1.019], [thin, thin], [0, 0]),
        ([1.0, 1.021], [thin, thin], [0, 1]),
        ([10.0, 10.19], [thin, thin], [0, 0]),
        ([10.0, 10.21], [thin, thin], [0, 1]),
        ([1.0, 1.01, 1.02, 1.03, 1.04], [thin] * 5, [0, 0, 0, 0, 0]),  # a chain is one surface
        ([1.0, 2.0, 2.01, 5.0], [thin] * 4, [0, 1, 1, 2]),
    ]
    for t, precision, expected in cases:
        config = replace(LAYERED, layer_gap_relative=0.02)
        assert layer_index(_hits(t, [0.0] * len(t), precision), config)[0].tolist() == expected


def test_layers_are_aggregated_apart() -> None:
    hits = _hits([1.0, 2.0, 2.01, 5.0], [0.0, 1.0, 1.0, 2.0], [1e6] * 4)
    samples = aggregate(hits, LAYERED)
    expected = torch.tensor([[[1.0, 0, 0, 0], [0, 0.5, 0.5, 0], [0, 0, 0, 1.0]]])
    torch.testing.assert_close(samples.features, expected)
    torch.testing.assert_close(samples.t, torch.tensor([[1.0, 2.005, 5.0]]))
    within = aggregate(hits, WHOLE_LAYER).features[0]
    assert (within[1] > 0).tolist() == [False, True, True, False]
    assert (within[3] > 0).tolist() == [False, False, False, True]


def test_rays_without_hits_have_no_samples() -> None:
    hits = _random_hits(5, 3, 3, spread=0.1)
    empty = replace(hits, valid=torch.zeros_like(hits.valid))
    for config in (LAYERED, WINDOW_2, WHOLE_LAYER):
        samples = aggregate(empty, config)
        assert not samples.valid.any()
        assert torch.isfinite(samples.features).all()
