"""Stage 2: along the ray, to the depth of the paper's formulas or of the provider, with the footprints kept."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates

from orca.anchors import GaussianAnchors
from orca.camera import Camera
from orca.config import DeformConfig, PlacementConfig, PlanarConfig, RenderConfig
from orca.errors import BadInput
from orca.field.decoders import analytic_decoders
from orca.render.renderer import Renderer
from orca.stages.canvas import Canvas
from orca.stages.deform import RelativeTarget, cleaned_depth, deform, sample_depth, sharpen_depth
from orca.stages.planar import planar_anchors, regular_grid
from tests.orca.stage_inputs import plane_depth, psnr, random_depth, view

Lifting = Literal["metric", "relative"]
LIFTINGS: tuple[Lifting, ...] = ("metric", "relative")
METRIC = DeformConfig(lifting="metric", denoise_depth=False)
RELATIVE = DeformConfig(lifting="relative", denoise_depth=False)
SMOOTH = replace(RELATIVE, sharpen_depth=False, follow_slope=False)


def plane_anchors(camera: Camera, per_pixel: float = 0.25, thickness: float = 0.3) -> GaussianAnchors:
    """A regular grid of anchors on the plane z = 1, with random colours."""
    size = (camera.height, camera.width)
    canvas = Canvas(np.zeros((*size, 3), np.float32), np.ones(size, np.float32), camera, (0, 0, 0, 0))
    config = PlanarConfig(placement=PlacementConfig(kind="grid"), anchors_per_pixel=per_pixel, thickness=thickness)
    anchors = planar_anchors(canvas, regular_grid(canvas, config), config)
    anchors.features[:, :3] = torch.randn(len(anchors), 3, generator=torch.Generator().manual_seed(0))
    return anchors


def constant(camera: Camera, depth: float) -> np.ndarray:
    return np.full((camera.height, camera.width), depth, np.float32)


def two_walls(camera: Camera, near: float = 1.0, far: float = 3.0) -> np.ndarray:
    """The left half near, the right half far."""
    depth = constant(camera, far)
    depth[:, : camera.width // 2] = near
    return depth


# --- the viewing rays ---------------------------------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from(LIFTINGS), st.booleans(), st.booleans(), st.floats(20, 110))
def test_no_projected_mean_moves(seed: int, lifting: Lifting, sharpen: bool, slope: bool, hfov: float) -> None:
    random = np.random.default_rng(seed)
    camera = view(72, 56, hfov).padded(*random.integers(0, 30, 4).tolist())
    anchors = plane_anchors(camera)
    config = DeformConfig(lifting=lifting, denoise_depth=False, sharpen_depth=sharpen, follow_slope=slope)
    moved = deform(anchors, random_depth(camera.height, camera.width, random), camera, config)
    before, _ = camera.project(anchors.means.double().numpy())
    after, z = camera.project(moved.means.double().numpy())
    assert np.abs(after - before).max() < 1e-3
    assert z.min() > 0


@pytest.mark.parametrize("lifting", LIFTINGS)
def test_no_projected_mean_moves_on_a_large_canvas(lifting: Lifting) -> None:
    camera = view(512, 512).padded(300, 300, 300, 300)
    anchors = plane_anchors(camera, per_pixel=0.01)
    depth = random_depth(1112, 1112, np.random.default_rng(0))
    moved = deform(anchors, depth, camera, DeformConfig(lifting=lifting))
    pixels = [camera.project(a.means.double().numpy())[0] for a in (anchors, moved)]
    assert np.abs(pixels[1] - pixels[0]).max() < 1e-3


def test_only_geometry_changes() -> None:
    camera = view()
    anchors = plane_anchors(camera)
    moved = deform(anchors, random_depth(64, 64, np.random.default_rng(3)), camera, METRIC)
    for name in ("features", "opacity_logits", "stage"):
        assert torch.equal(getattr(moved, name), getattr(anchors, name))


# --- the paper's formulas -----------------------------------------------------------------------------------------


def paper_means(mu: np.ndarray, d: np.ndarray, config: DeformConfig) -> np.ndarray:
    """Section 3.2 as printed: the z axis points from the plane to the camera, the camera is at c."""
    c = np.zeros(3)
    q = 1 / np.maximum(d, config.epsilon)
    q_far, q_near = np.quantile(q, config.far_quantile), np.quantile(q, config.near_quantile)
    s = np.clip((q - q_far) / (q_near - q_far), 0, 1)
    z_base = np.median(mu[:, 2])
    x, y = mu[:, 0], mu[:, 1]
    L_xy = max(x.max() - x.min(), y.max() - y.min())
    z = z_base + config.strength * L_xy * s
    gamma = (c[2] - z) / (c[2] - mu[:, 2])
    return c + gamma[:, None] * (mu - c)


@pytest.mark.parametrize("strength", [0.1, 0.25, 0.4])
@pytest.mark.parametrize(("width", "height"), [(64, 64), (80, 48), (40, 72)])
def test_relative_lifting_is_the_papers(strength: float, width: int, height: int) -> None:
    camera = view(width, height)
    y, x = np.meshgrid(np.linspace(0, 3, height), np.linspace(0, 4, width), indexing="ij")
    depth = (2 + 0.5 * np.sin(x) + 0.4 * np.cos(y)).astype(np.float32)
    anchors, config = plane_anchors(camera), replace(SMOOTH, strength=strength)
    flip = np.array([1, 1, -1])  # OpenCV's z points from the camera to the plane
    mu = anchors.means.double().numpy()
    pixels, _ = camera.project(mu)
    d = map_coordinates(depth.astype(np.float64), pixels[:, ::-1].T - 0.5, order=1, mode="nearest")
    expected = paper_means(mu * flip, d, config) * flip
    np.testing.assert_allclose(deform(anchors, depth, camera, config).means.numpy(), expected, atol=2e-6)
    # Nearer is nearer to the camera, which in the paper's axis is a larger z.
    assert (expected * flip)[:, 2].min() >= np.median(-mu[:, 2]) - 1e-9


def test_the_papers_lookup_differs_from_ours_by_half_a_cell_at_most() -> None:
    """The paper normalises x and y by the cloud's extent; the camera's projection does not stretch by half a cell."""
    camera = view(64, 48)
    mu = plane_anchors(camera).means.double().numpy()
    low, high = mu[:, :2].min(0), mu[:, :2].max(0)
    papers = (mu[:, :2] - low) / (high - low) * [64, 48]
    np.testing.assert_allclose(papers, camera.project(mu)[0], atol=1.0 + 1e-4)  # cells of 2 pixels


@pytest.mark.parametrize("slope", [False, True])
def test_constant_depth_deforms_nothing_in_relative_mode(slope: bool) -> None:
    camera = view()
    anchors = plane_anchors(camera)
    with np.errstate(all="raise"):
        moved = deform(anchors, constant(camera, 7.0), camera, replace(RELATIVE, follow_slope=slope))
    assert torch.equal(moved.means, anchors.means)
    assert torch.equal(moved.log_variances, anchors.log_variances)
    assert torch.equal(moved.quaternions, anchors.quaternions)


def test_relative_lifting_ignores_the_unit_of_the_depth() -> None:
    camera, depth = view(), random_depth(64, 64, np.random.default_rng(5))
    anchors = plane_anchors(camera)
    once, thousandfold = (deform(anchors, depth * np.float32(f), camera, RELATIVE).means for f in (1, 1000))
    torch.testing.assert_close(once, thousandfold, rtol=1e-4, atol=1e-5)


def test_a_strength_that_reaches_through_the_camera_stops_before_it() -> None:
    camera = view()
    moved = deform(plane_anchors(camera), two_walls(camera), camera, replace(RELATIVE, strength=50.0))
    assert float(moved.means[:, 2].min()) == pytest.approx(0.1, rel=1e-5)


def test_nearness_spans_the_quantiles() -> None:
    depth = np.concatenate([np.full(50, 4.0), np.full(50, 2.0), [1e9, 1e-9]])
    target = RelativeTarget.fit(np.ones((102, 3)), depth, replace(RELATIVE, far_quantile=0.1, near_quantile=0.9))
    assert (target.q_far, target.q_near) == (0.25, 0.5)
    np.testing.assert_allclose(target.nearness(np.array([100.0, 4.0, 8 / 3, 2.0, 0.01])), [0, 0, 0.5, 1, 1])


# --- depth ordering and the provider's depth ------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from(LIFTINGS))
def test_nearer_depth_gives_nearer_anchors(seed: int, lifting: Lifting) -> None:
    camera = view(48, 40)
    anchors = plane_anchors(camera)
    config = DeformConfig(lifting=lifting, denoise_depth=False, sharpen_depth=False)
    depth = random_depth(40, 48, np.random.default_rng(seed))
    sampled = sample_depth(depth, camera.project(anchors.means.double().numpy())[0])
    z = deform(anchors, depth, camera, config).means[:, 2].numpy()
    order = np.argsort(sampled, kind="stable")
    assert (np.diff(z[order]) >= -1e-6 * z[order][1:]).all()
    assert z[order[0]] < z[order[-1]]


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31), st.booleans())
def test_metric_lifting_is_the_sampled_depth(seed: int, slope: bool) -> None:
    camera = view(48, 40)
    anchors = plane_anchors(camera)
    depth = random_depth(40, 48, np.random.default_rng(seed))
    config = replace(METRIC, sharpen_depth=False, follow_slope=slope)
    moved = deform(anchors, depth, camera, config)
    pixels, _ = camera.project(anchors.means.double().numpy())
    np.testing.assert_allclose(moved.means[:, 2].numpy(), sample_depth(depth, pixels), rtol=1e-6)


def test_sampling_by_hand() -> None:
    depth = np.array([[1.0, 1.02], [1.01, 1.04]], np.float32)
    pixels = np.array([[0.5, 0.5], [1.5, 0.5], [1.0, 0.5], [1.0, 1.0], [0.75, 1.5], [-3.0, 9.0]])
    np.testing.assert_allclose(sample_depth(depth, pixels), [1, 1.02, 1.01, 1.0175, 1.0175, 1.01], rtol=1e-6)


def test_across_an_edge_the_nearest_sample_counts() -> None:
    depth = np.array([[1.0, 2.0]] * 2, np.float32)
    pixels = np.array([[0.9, 1.0], [1.1, 1.0]])
    np.testing.assert_array_equal(sample_depth(depth, pixels), [1, 2])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 0.0, -1.0])
@pytest.mark.parametrize("lifting", LIFTINGS)
def test_depth_that_is_not_finite_and_positive_is_refused(bad: float, lifting: Lifting) -> None:
    camera = view(32, 32)
    depth = constant(camera, 2.0)
    depth[3, 4:6] = bad
    with pytest.raises(BadInput, match="2 of 1024 values"):
        deform(plane_anchors(camera), depth, camera, DeformConfig(lifting=lifting))


# --- extents --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gamma", [0.25, 0.5, 3.0])
@pytest.mark.parametrize("slope", [False, True])
def test_extents_follow_gamma_on_a_fronto_parallel_wall(gamma: float, slope: bool) -> None:
    camera = view()
    anchors = plane_anchors(camera)
    moved = deform(anchors, constant(camera, gamma), camera, replace(METRIC, follow_slope=slope))
    torch.testing.assert_close(
        moved.log_variances - anchors.log_variances, torch.full((len(anchors), 3), 2 * np.log(gamma))
    )
    assert torch.equal(moved.quaternions, anchors.quaternions)


def test_each_wall_has_its_own_gamma() -> None:
    camera = view()
    anchors = plane_anchors(camera)
    moved = deform(anchors, two_walls(camera, 0.5, 4.0), camera, replace(METRIC, follow_slope=False))
    gamma = moved.means[:, 2] / anchors.means[:, 2]
    assert sorted(set(gamma.tolist())) == [0.5, 4.0]
    torch.testing.assert_close(moved.log_variances, anchors.log_variances + 2 * torch.log(gamma)[:, None])


def tilted(degrees: float) -> tuple[Camera, np.ndarray]:
    """A wall tilted about both axes, and the camera that sees nothing else."""
    angle = np.radians(degrees)
    return view(96, 96), np.array([np.sin(angle) * 0.9, -np.sin(angle) * np.sqrt(1 - 0.81), np.cos(angle)])


def floor() -> tuple[Camera, np.ndarray]:
    """A floor parallel to the optical axis, seen by a camera whose frame lies below the horizon."""
    return Camera(np.array([[64.0, 0, 64], [0, 64, -30], [0, 0, 1]]), np.eye(4), 128, 64), np.array([0.0, 1, 0])


SURFACES = [tilted(15), tilted(30), tilted(40), floor()]


def on_surface(
    camera: Camera, normal: np.ndarray, thickness: float = 0.3
) -> tuple[GaussianAnchors, GaussianAnchors, np.ndarray]:
    """Anchors before and after a deformation to a plane, and the plane's depth."""
    depth = plane_depth(camera, normal, 0.7)
    assert depth.min() > 0
    anchors = plane_anchors(camera, thickness=thickness)
    return anchors, deform(anchors, depth.astype(np.float32), camera, METRIC), depth


@pytest.mark.parametrize(("camera", "normal"), SURFACES)
@pytest.mark.parametrize("thickness", [0.05, 0.3])
def test_gaussians_lie_flat_on_a_tilted_surface(camera: Camera, normal: np.ndarray, thickness: float) -> None:
    _, moved, _ = on_surface(camera, normal, thickness)
    smallest = moved.log_variances.argmin(1)
    axis = moved.rotations().double().numpy()[np.arange(len(moved)), :, smallest]
    degrees = np.degrees(np.arccos(np.clip(np.abs(axis @ normal), 0, 1)))
    assert degrees.max() < 1.2


@pytest.mark.parametrize(("camera", "normal"), SURFACES)
def test_a_tilt_changes_volume_by_gamma_alone(camera: Camera, normal: np.ndarray) -> None:
    """det = gamma^6 det before: no Gaussian collapses, not even where the surface is parallel to the axis."""
    anchors, moved, _ = on_surface(camera, normal)
    gamma = moved.means[:, 2] / anchors.means[:, 2]
    growth = (moved.log_variances - anchors.log_variances).sum(1)
    torch.testing.assert_close(growth, 6 * torch.log(gamma), atol=1e-4, rtol=1e-4)
    # Thickness is at least that of the plane's disc seen at the steepest slope allowed.
    thinner = moved.log_variances.min(1).values - (anchors.log_variances.min(1).values + 2 * torch.log(gamma))
    assert float(torch.exp(0.5 * thinner).min()) > 0.15


@pytest.mark.parametrize(("camera", "normal"), SURFACES)
def test_the_input_view_keeps_its_footprints(camera: Camera, normal: np.ndarray) -> None:
    anchors, moved, depth = on_surface(camera, normal)
    decoders = analytic_decoders(15.0, torch.Generator().manual_seed(0))
    before, after = (Renderer(a, decoders, RenderConfig()) for a in (anchors, moved))
    image, again = before.render(camera), after.render(camera)
    np.testing.assert_allclose(again.alpha, image.alpha, atol=5e-4)
    assert psnr(again.rgb, image.rgb) > 40  # of colours drawn at random for each anchor
    np.testing.assert_allclose(again.depth, depth, rtol=3e-3)
    hits_before, hits_after = (int(r.hits(camera).count.sum()) for r in (before, after))
    assert abs(hits_after / hits_before - 1) < 0.2  # those near the rim of an ellipse may come or go


@pytest.mark.parametrize("follow", [True, False])
def test_without_following_extents_the_input_view_blurs(follow: bool) -> None:
    """The check above can fail: what stays unchanged when the discs follow changes when they do not."""
    camera, normal = tilted(40)
    anchors = plane_anchors(camera)
    depth = plane_depth(camera, normal, 0.7).astype(np.float32)
    moved = deform(anchors, depth, camera, METRIC)
    if not follow:
        moved = replace(moved, log_variances=anchors.log_variances, quaternions=anchors.quaternions)
    decoders = analytic_decoders(15.0, torch.Generator().manual_seed(0))
    image, again = (Renderer(a, decoders, RenderConfig()).render(camera).rgb for a in (anchors, moved))
    assert (psnr(again, image) > 40) == follow


def test_a_wide_step_tilts_nothing_away_from_it() -> None:
    camera = view()
    anchors = plane_anchors(camera)
    moved = deform(anchors, two_walls(camera), camera, METRIC)
    pixels, _ = camera.project(anchors.means.double().numpy())
    away = np.abs(pixels[:, 0] - 32) > 5
    assert torch.equal(moved.quaternions[away], anchors.quaternions[away])
    at_step = torch.from_numpy(np.abs(pixels[:, 0] - 32) < 1.5)
    assert torch.equal(moved.quaternions[at_step], anchors.quaternions[at_step])  # too steep to be one surface


# --- edges ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("width", [1, 2, 3, 4])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_soft_edge_becomes_a_step_between_its_two_levels(width: int, axis: int) -> None:
    profile = np.exp(np.interp(np.arange(48), [20, 20 + width], [np.log(1.0), np.log(3.0)]))
    depth = np.tile(profile.astype(np.float32), (40, 1))
    depth = depth if axis == 1 else np.ascontiguousarray(depth.T)
    sharp = sharpen_depth(depth, 1.06)
    profile = sharp[20] if axis == 1 else sharp[:, 20]
    np.testing.assert_allclose(np.where(profile < 1.7, 1.0, 3.0), profile, rtol=1e-6)
    assert (np.diff(profile) >= 0).all()
    assert 20 < np.argmax(profile > 2) <= 20 + width


@pytest.mark.parametrize("slope", [0.001, 0.02, 0.08])
def test_slopes_and_walls_are_left_as_they_are(slope: float) -> None:
    """Also a slope whose depth changes by more than the edge ratio within the window."""
    depth = np.tile(np.exp(slope * np.arange(64)).astype(np.float32), (48, 1))
    np.testing.assert_array_equal(sharpen_depth(depth, 1.06)[:, 6:-6], depth[:, 6:-6])
    wall = np.full((48, 64), 2.5, np.float32)
    np.testing.assert_array_equal(sharpen_depth(wall, 1.06), wall)


def test_a_step_below_the_edge_ratio_stays_soft() -> None:
    depth = np.tile(np.interp(np.arange(48), [20, 24], [1.0, 1.05]).astype(np.float32), (40, 1))
    np.testing.assert_array_equal(sharpen_depth(depth, 1.06), depth)


def test_no_anchor_floats_between_two_surfaces() -> None:
    camera = view()
    depth = np.tile(np.interp(np.arange(64), [30, 34], [1.0, 3.0]).astype(np.float32), (64, 1))
    z = deform(plane_anchors(camera), cleaned_depth(depth, METRIC), camera, METRIC).means[:, 2].numpy()
    np.testing.assert_allclose(np.where(z < 1.7, 1.0, 3.0), z, rtol=1e-5)
    soft = deform(plane_anchors(camera), depth, camera, METRIC).means[:, 2].numpy()
    assert ((soft > 1.2) & (soft < 2.8)).any()
