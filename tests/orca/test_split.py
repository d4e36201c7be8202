"""Splats are split where the fit errs: who is to blame, how many, and what becomes of each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orca.conventions import Float32Array
from orca.errors import BadInput
from orca.splats.gradient import Footprints, footprints
from orca.splats.model import Splats
from orca.splats.split import blame, split, stages, worst
from orca.splats.view import view_splats
from tests.orca.stage_inputs import view

CAMERA = view(48, 48)


def make(count: int = 200, seed: int = 0) -> Splats:
    """Overlapping splats of any shape in front of the camera, the second half of another stage."""
    rng = np.random.default_rng(seed)
    quaternions = rng.normal(size=(count, 4))
    depth = rng.uniform(1, 2, count)
    means = np.column_stack([rng.uniform(-0.5, 0.5, (count, 2)) * depth[:, None], depth])
    return Splats(
        means.astype(np.float32),
        np.log(rng.uniform(0.01, 0.08, (count, 3))).astype(np.float32),
        (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).astype(np.float32),
        rng.uniform(0, 1, (count, 3)).astype(np.float32),
        rng.uniform(0.2, 0.9, count).astype(np.float32),
        (np.arange(count) >= count // 2).astype(np.uint8),
    )


def seen(splats: Splats) -> tuple[Footprints, Float32Array, Float32Array]:
    """Footprints, the picture [P, 3] and the coverage [P]."""
    shown = view_splats(splats, CAMERA)
    return footprints(splats, CAMERA, 1.0), shown.rgb.reshape(-1, 3), shown.alpha.reshape(-1)


def test_the_blame_of_all_is_the_error_where_they_cover() -> None:
    splats = make()
    where, picture, alpha = seen(splats)
    off = np.random.default_rng(1).normal(0, 0.2, picture.shape).astype(np.float32)
    target = np.column_stack([picture + off, alpha])
    blamed = blame(where, picture, target, splats)
    assert blamed.sum() == pytest.approx(float((alpha[:, None] * off**2).sum()), rel=1e-3)
    assert len(blamed) == len(splats)


def test_who_is_not_seen_where_it_errs_has_no_blame() -> None:
    splats = make()
    where, picture, alpha = seen(splats)
    x = np.arange(len(picture)) % CAMERA.width
    target = np.column_stack([picture + 0.3 * (x < 12)[:, None], alpha]).astype(np.float32)
    blamed = blame(where, picture, target, splats)
    reach = 4 * np.sqrt(where.covariance[:, 0] + 0.3)
    assert (blamed[where.centre[:, 0] - reach > 12] < 1e-3).all()
    assert blamed[where.centre[:, 0] < 9].sum() > 0.6 * blamed.sum()


@pytest.mark.parametrize(
    ("surplus_db", "expected"),
    [
        (0.4, [4]),  # 9 % of the error is to go: 3 of the worst's 5
        (3.0103, [4, 1]),  # half of 10, and a split takes 70 % of its blame: .7 * 5 < 5 <= .7 * 9
        (30.0, [4, 1, 6]),  # all of it, but a third of nine at most
    ],
)
def test_as_few_as_the_error_asks_for(surplus_db: float, expected: list[int]) -> None:
    assert worst(np.array([0, 4, 0.2, 0, 5, 0.1, 0.5, 0.1, 0.1]), surplus_db).tolist() == expected


def test_halves_keep_centre_and_shape() -> None:
    """Means average to the parent's; along the longest axis .5^2 + .6^2 = .61 of the variance, across it all."""
    splats = make(20)
    chosen = np.array([7, 3])
    halves = split(splats, chosen)
    assert len(halves) == 22
    others = np.setdiff1d(np.arange(20), chosen)
    for name in ("means", "log_scales", "quaternions", "colours", "opacities", "stage"):
        np.testing.assert_array_equal(getattr(halves, name)[others], getattr(splats, name)[others])
    for row, (i, j) in enumerate(zip(chosen, (20, 21), strict=True)):
        a, b = halves.means[i].astype(float), halves.means[j].astype(float)
        np.testing.assert_allclose((a + b) / 2, splats.means[chosen[row]], atol=1e-6)
        pair = (halves.covariances()[i] + halves.covariances()[j]) / 2 + np.outer(a - b, a - b) / 4
        before = np.linalg.eigvalsh(splats.covariances()[i].astype(float))
        after = np.sort(np.linalg.eigvalsh(pair))
        np.testing.assert_allclose(after, np.sort([before[0], before[1], 0.61 * before[2]]), rtol=1e-3)
        np.testing.assert_array_equal(halves.colours[j], splats.colours[i])
        assert halves.stage[j] == splats.stage[i]


def test_stages_are_found_again() -> None:
    """After two rounds, from what a file holds; files of other anchors, of fewer, and of far too many are refused."""
    anchors = make()
    twice = split(split(anchors, np.arange(0, 200, 3)), np.arange(0, 260, 5))
    read = replace(twice, stage=np.zeros(len(twice), np.uint8))
    found = stages(read, anchors).stage
    np.testing.assert_array_equal(found[: len(anchors)], anchors.stage)
    assert (found == twice.stage).mean() > 0.95  # two anchors may be closer than the halves of one
    turned = replace(anchors, quaternions=np.roll(anchors.quaternions, 1, axis=1))
    for wrong in (make(250, seed=1), make(199), turned, split(twice, np.arange(len(twice)))):
        with pytest.raises(BadInput, match="does not follow the scene's 200 anchors"):
            stages(wrong, anchors)
