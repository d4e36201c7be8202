"""The fast ray selector against its definition, hit for hit, and the closest-approach formulas against a minimiser."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numba
import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from orca.anchors import GaussianAnchors
from orca.camera import Camera
from orca.config import RenderConfig
from orca.conventions import Float64Array
from orca.render import HitList, select, select_brute_force
from orca.render.selector import ray_anchor_closest_approach
from orca.threads import map_on_cores
from tests.orca.anchor_scenes import one_anchor, random_anchors, random_camera

CONFIG = RenderConfig(max_hits=100_000)
BORDER = 1e-9  # hits this close to chi2 may fall on either side of a rounding error


def _table(hits: HitList) -> tuple[NDArray[np.int64], Float64Array]:
    """Key ray * 2^32 + anchor of every kept hit, ascending, and its (t, m2, precision)."""
    keep = np.arange(hits.count.sum()) + np.repeat(hits.start - np.cumsum(hits.count) + hits.count, hits.count)
    keys = (np.repeat(np.arange(hits.num_rays), hits.count) << 32) + hits.anchor[keep]
    order = np.argsort(keys)
    values = np.stack([hits.t_hit[keep], hits.m2[keep], hits.precision[keep]], 1).astype(np.float64)
    return keys[order], values[order]


def _margin(anchors: GaussianAnchors, camera: Camera, ray: int, who: int, config: RenderConfig) -> float:
    """How far a hit is from being decided the other way, in chi2 or in depth, in float64."""
    t, m2, _ = ray_anchor_closest_approach(
        torch.from_numpy(camera.center),
        torch.from_numpy(camera.rays()[ray]),
        anchors.means[who].double(),
        anchors.whitening()[who].double(),
    )
    return min(abs(float(m2) - config.chi2), abs(float(t) - config.near))


def _compare(anchors: GaussianAnchors, camera: Camera, config: RenderConfig) -> int:
    """Hold `select` to `select_brute_force`; the number of hits compared."""
    fast, slow = select(anchors, camera, config), select_brute_force(anchors, camera, config)
    (a, a_values), (b, b_values) = _table(fast), _table(slow)
    assert len(np.unique(a)) == len(a)
    for key in np.setxor1d(a, b).tolist():
        assert _margin(anchors, camera, key >> 32, key & 0xFFFFFFFF, config) < BORDER
    common, of_a, of_b = np.intersect1d(a, b, return_indices=True)
    assert len(common) >= len(b) - 2  # borderline hits are a rarity, not a way out
    np.testing.assert_allclose(a_values[of_a], b_values[of_b], rtol=1e-5, atol=1e-7)
    assert fast.culled_inside == slow.culled_inside
    _assert_sorted(fast)
    return len(common)


def _assert_sorted(hits: HitList) -> None:
    """Every ray's rows are its own, by (t_hit, anchor); which ray's come first is left open."""
    some = np.flatnonzero(hits.count)
    order = some[np.argsort(hits.start[some], kind="stable")]
    ray = np.repeat(np.arange(len(order)), hits.count[order])
    assert len(ray) == len(hits.anchor)  # nothing cut off
    assert (hits.start[order] == np.cumsum(hits.count[order]) - hits.count[order]).all()
    order = np.lexsort((hits.anchor, hits.t_hit, ray))
    assert (order == np.arange(len(order))).all()


SCENES = {
    "isotropic to flat": (0, 250, 61, 43, (0.01, 0.25), (0.3, 6.0)),
    "needles": (1, 250, 53, 71, (0.002, 0.6), (0.5, 5.0)),
    "small": (2, 900, 64, 40, (0.01, 0.05), (0.5, 4.0)),
    "around the camera": (3, 150, 40, 48, (0.05, 0.5), (0.01, 1.5)),
    "large": (4, 120, 47, 33, (0.1, 0.8), (0.5, 6.0)),
}


def test_select_equals_the_definition_hit_for_hit() -> None:
    total = 0
    for seed, count, width, height, sigma, depth in SCENES.values():
        camera = random_camera(seed, width, height)
        total += _compare(random_anchors(seed, count, camera, sigma, depth), camera, CONFIG)
    assert total >= 50_000


@pytest.mark.parametrize("chi2", [1.0, 11.3449])
def test_select_equals_the_definition_at_other_cutoffs(chi2: float) -> None:
    camera = random_camera(7)
    assert _compare(random_anchors(7, 150, camera), camera, replace(CONFIG, chi2=chi2)) > 500


@pytest.mark.parametrize("near", [0.5, 1.5])
def test_near_cuts_single_hits_and_not_whole_anchors(near: float) -> None:
    camera = random_camera(8)
    anchors = random_anchors(8, 150, camera, (0.05, 0.5), (0.1, 3.0))
    config = replace(CONFIG, near=near)
    assert _compare(anchors, camera, config) > 1000
    assert select(anchors, camera, config).t_hit.min() > near


def test_an_ellipsoid_across_the_camera_plane_is_seen_where_it_is_in_front() -> None:
    """Its outline is a hyperbola: no bounding ellipse, yet rays do hit it."""
    camera = Camera.from_fov(40, 30, 60)
    anchors = one_anchor([0.0, 0.5, 1.0], [0.1, 0.1, 0.6])
    hits = select(anchors, camera, CONFIG)
    assert hits.culled_inside == 0
    assert _compare(anchors, camera, CONFIG) > 50
    assert hits.t_hit.min() > CONFIG.near


def test_a_camera_inside_an_ellipsoid_culls_it_and_says_so() -> None:
    camera = Camera.from_fov(16, 12, 60)
    inside, outside = one_anchor([0, 0, 1], 0.5), one_anchor([0, 0, 1], 0.39)  # 2.5 sigma: 1.25 and 0.975
    both = GaussianAnchors.concatenate(inside, outside)
    hits = select(both, camera, CONFIG)
    assert hits.culled_inside == 1
    assert set(hits.anchor.tolist()) == {1}
    assert select_brute_force(both, camera, CONFIG).culled_inside == 1


def test_anchors_behind_the_camera_are_never_hit() -> None:
    camera = random_camera(9)
    anchors = random_anchors(9, 40, camera, (0.01, 0.05), (0.5, 3.0))
    mirrored = replace(anchors, means=2 * torch.from_numpy(camera.center).float() - anchors.means)
    depth = camera.project(mirrored.means.numpy())[1]
    hits = select(mirrored, camera, CONFIG)
    assert (depth < 0).sum() > 30
    assert (depth[np.unique(hits.anchor)] > 0).all()


def test_no_hit_at_all() -> None:
    camera = Camera.from_fov(9, 5, 50)
    hits = select(one_anchor([50, 0, 1], 0.01), camera, CONFIG)
    assert hits.count.tolist() == [0] * 45
    assert len(hits.anchor) == len(hits.t_hit) == 0
    assert (hits.overflow, hits.culled_inside) == (0, 0)
    assert hits.padded().tolist() == [[-1]] * 45


def test_an_image_of_one_pixel() -> None:
    camera = Camera.from_fov(1, 1, 60)
    hits = select(one_anchor([0.1, 0.0, 2.0], 0.1), camera, CONFIG)
    assert hits.count.tolist() == [1]
    assert hits.t_hit[0] == pytest.approx(2.0)
    assert hits.m2[0] == pytest.approx(1.0, rel=1e-5)  # one sigma off the axis
    assert hits.precision[0] == pytest.approx(100.0, rel=1e-5)


def test_a_full_ray_keeps_the_nearest_and_counts_the_rest() -> None:
    camera = random_camera(4, 30, 20)
    anchors = random_anchors(4, 120, camera, (0.1, 0.8))
    everything = select(anchors, camera, CONFIG)
    capped = select(anchors, camera, replace(CONFIG, max_hits=3))
    assert everything.count.max() > 10
    assert everything.overflow == 0
    assert capped.overflow == int(np.maximum(everything.count - 3, 0).sum())
    assert capped.count.tolist() == np.minimum(everything.count, 3).tolist()
    np.testing.assert_array_equal(capped.padded(), everything.padded()[:, :3])
    assert select_brute_force(anchors, camera, replace(CONFIG, max_hits=3)).overflow == capped.overflow


def test_equal_depths_are_ordered_by_anchor() -> None:
    camera = Camera.from_fov(8, 8, 60)
    same = select(GaussianAnchors.concatenate(*[one_anchor([0, 0, 2], 0.3)] * 5), camera, CONFIG)
    assert same.padded()[8 * 4 + 4].tolist() == [0, 1, 2, 3, 4]
    _assert_sorted(same)


@pytest.mark.parametrize("log_variance", [-177.0, -120.0, -60.0, -30.0, 20.0, 60.0, 170.0])
def test_degenerate_variances_do_not_crash(log_variance: float) -> None:
    camera = Camera.from_fov(12, 10, 60)
    mean = camera.unproject(np.array([[5.5, 4.5]]), np.array([2.0]))[0]
    anchors = replace(one_anchor(mean, 1.0), log_variances=torch.full((1, 3), log_variance))
    hits = select(anchors, camera, CONFIG)
    assert hits.culled_inside == (1 if log_variance > 0 else 0)  # a huge one holds the camera
    assert hits.count.sum() <= 1  # a tiny one is hit at the centre, if rounding lets it
    thin = replace(anchors, log_variances=torch.tensor([[log_variance, -4.0, -4.0]]))
    assert np.isfinite(select(thin, camera, CONFIG).m2).all()


def test_broken_parameters_are_never_hit() -> None:
    camera = Camera.from_fov(12, 10, 60)
    good = one_anchor([0, 0, 2], 0.2)
    for name in ("means", "log_variances"):
        for value in (float("nan"), float("inf")):
            broken = replace(good, **{name: torch.full((1, 3), value)})
            hits = select(GaussianAnchors.concatenate(broken, good), camera, CONFIG)
            assert set(hits.anchor.tolist()) == {1}


@pytest.fixture
def all_threads() -> Iterator[None]:
    """Puts numba's thread count back; skips where there is one core only."""
    before = numba.get_num_threads()
    if before < 2:
        pytest.skip("one core")
    yield
    numba.set_num_threads(before)


def _assert_same(one: HitList, two: HitList) -> None:
    for name in ("start", "count", "anchor", "t_hit", "m2", "precision"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    assert one.overflow == two.overflow > 0


@pytest.mark.usefixtures("all_threads")
def test_thread_count_and_build_do_not_change_the_result() -> None:
    """One thread, two threads, and the serial build that workers use, bit for bit."""
    camera = random_camera(2, 80, 50)
    anchors = random_anchors(2, 600, camera, (0.02, 0.3))
    two = select(anchors, camera, RenderConfig(max_hits=8))
    serial = map_on_cores(lambda n: select(anchors, camera, RenderConfig(max_hits=n)), [8, 8])
    numba.set_num_threads(1)
    _assert_same(two, select(anchors, camera, RenderConfig(max_hits=8)))
    for other in serial:
        _assert_same(two, other)


def test_padded_hits_of_chosen_rays() -> None:
    camera = random_camera(5, 20, 15)
    hits = select(random_anchors(5, 100, camera, (0.05, 0.4)), camera, CONFIG)
    rays = np.array([7, 3, 299, 150])
    padded = hits.padded(rays)
    for row, ray in zip(padded, rays):
        own = hits.anchor[hits.start[ray] : hits.start[ray] + hits.count[ray]]
        assert row[row >= 0].tolist() == own.tolist()
        assert (row[len(own) :] == -1).all()


def _rays_and_anchors(count: int) -> tuple[torch.Tensor, torch.Tensor, GaussianAnchors]:
    camera = random_camera(11)
    anchors = random_anchors(11, count, camera, (0.05, 0.5), dtype=torch.float64)
    directions = torch.from_numpy(camera.rays()[:: len(camera.rays()) // count][:count])
    return torch.from_numpy(camera.center), directions, anchors


def test_closest_approach_is_the_minimum_of_the_mahalanobis_distance() -> None:
    origin, directions, anchors = _rays_and_anchors(30)
    t, m2, _ = ray_anchor_closest_approach(origin, directions, anchors.means, anchors.whitening())
    information = torch.linalg.inv(anchors.covariances()).numpy()
    for i in range(30):

        def distance(s: float, i: int = i) -> float:
            x = (origin + s * directions[i] - anchors.means[i]).numpy()
            return float(x @ information[i] @ x)

        found = minimize_scalar(distance, bracket=(float(t[i]) - 3.0, float(t[i]) + 2.0), tol=1e-12)
        assert float(t[i]) == pytest.approx(found.x, abs=1e-5)
        assert float(m2[i]) == pytest.approx(found.fun, rel=1e-8, abs=1e-8)


def test_distance_along_one_ray_needs_three_scalars_a_hit() -> None:
    """D_kj = (x_k - mu_j)^T Sigma_j^-1 (x_k - mu_j) = m2_j + a_j (t_k - t_j)^2, for all points x_k of the ray."""
    origin, directions, anchors = _rays_and_anchors(40)
    direction = directions[17]
    t, m2, a = ray_anchor_closest_approach(origin, direction, anchors.means, anchors.whitening())
    offset = (origin + t[:, None] * direction)[:, None] - anchors.means[None]  # [k, j, 3]
    information = torch.linalg.inv(anchors.covariances())
    direct = torch.einsum("kja,jab,kjb->kj", offset, information, offset)
    short = m2[None] + a[None] * (t[:, None] - t[None]) ** 2
    torch.testing.assert_close(short, direct, rtol=1e-8, atol=1e-8)
