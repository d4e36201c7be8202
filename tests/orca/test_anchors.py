"""Gaussian anchors: rotations, whitening, shapes."""

from __future__ import annotations

import itertools
from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from orca.anchors import FEATURE_DIM, GaussianAnchors, Stage, quaternions_to_rotations, rotations_to_quaternions
from orca.errors import BadInput
from tests.orca.anchor_scenes import random_anchors, random_camera

_AXES = [axis for axis in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(axis)]


def _half_turns() -> torch.Tensor:
    """Rotations by 180 degrees about all axes of a cube, and by nearly that: where w vanishes."""
    axes = np.array(_AXES) / np.linalg.norm(_AXES, axis=1, keepdims=True)
    vectors = np.concatenate([axes * np.pi, axes * (np.pi - 1e-7), axes * (np.pi / 2), axes * 0])
    return torch.from_numpy(Rotation.from_rotvec(vectors).as_matrix())


def _random_turns() -> torch.Tensor:
    return torch.from_numpy(Rotation.random(200, random_state=0).as_matrix())


@pytest.mark.parametrize("turns", [_half_turns, _random_turns])
def test_rotations_survive_the_way_through_quaternions(turns: object) -> None:
    rotations = turns()  # type: ignore[operator]
    quaternions = rotations_to_quaternions(rotations)
    torch.testing.assert_close(quaternions.norm(dim=1), torch.ones(len(rotations), dtype=torch.float64))
    torch.testing.assert_close(quaternions_to_rotations(quaternions), rotations, rtol=0, atol=1e-12)


def test_quaternions_are_wxyz_as_scipy_has_them() -> None:
    wxyz = np.random.default_rng(0).normal(size=(50, 4))
    expected = Rotation.from_quat(wxyz[:, [1, 2, 3, 0]]).as_matrix()
    rotations = quaternions_to_rotations(torch.from_numpy(wxyz))
    np.testing.assert_allclose(rotations.numpy(), expected, atol=1e-12)
    back = rotations_to_quaternions(rotations).numpy()
    unit = wxyz / np.linalg.norm(wxyz, axis=1, keepdims=True)
    np.testing.assert_allclose(back * np.sign((back * unit).sum(1, keepdims=True)), unit, atol=1e-12)


def test_a_quarter_turn_by_hand() -> None:
    """w = z = sqrt(1/2): 90 degrees about z takes x to y."""
    rotation = quaternions_to_rotations(torch.tensor([[1.0, 0.0, 0.0, 1.0]]))[0]
    torch.testing.assert_close(rotation @ torch.tensor([1.0, 0, 0]), torch.tensor([0.0, 1, 0]))


def _anchors(dtype: torch.dtype = torch.float64) -> GaussianAnchors:
    return random_anchors(0, 60, random_camera(0), (0.01, 0.5), dtype=dtype)


def test_whitening_turns_the_covariance_into_the_identity() -> None:
    anchors = _anchors()
    whitening = anchors.whitening()
    identity = whitening @ anchors.covariances() @ whitening.transpose(1, 2)
    torch.testing.assert_close(identity, torch.eye(3, dtype=torch.float64).expand(60, 3, 3), rtol=0, atol=1e-9)


def test_covariance_has_the_variances_along_the_principal_axes() -> None:
    anchors = _anchors()
    along = torch.einsum("nia,nij,nja->na", anchors.rotations(), anchors.covariances(), anchors.rotations())
    torch.testing.assert_close(along, anchors.log_variances.exp())


def test_subset_concatenate_and_detach() -> None:
    anchors = _anchors(torch.float32)
    mask = torch.arange(60) < 20
    whole = GaussianAnchors.concatenate(anchors.subset(mask), anchors.subset(~mask))
    for f in fields(anchors):
        assert torch.equal(getattr(whole, f.name), getattr(anchors, f.name))
    assert len(whole) == 60
    picked = anchors.subset(torch.tensor([5, 2]))
    assert torch.equal(picked.means, anchors.means[[5, 2]])
    tracked = replace(anchors, means=anchors.means.clone().requires_grad_())
    assert not tracked.detached().means.requires_grad


def test_with_features_keeps_the_geometry() -> None:
    anchors = _anchors(torch.float32)
    other = anchors.with_features(torch.zeros(60, FEATURE_DIM))
    assert other.means is anchors.means
    assert not other.features.any()


@pytest.mark.parametrize("name", [f.name for f in fields(GaussianAnchors)])
def test_wrong_shapes_are_rejected_by_name(name: str) -> None:
    anchors = _anchors(torch.float32)
    broken = getattr(anchors, name)[:-1]
    with pytest.raises(BadInput, match=f"{'log_variances' if name == 'means' else name} of shape"):
        replace(anchors, **{name: broken})


def test_stages_keep_their_numbers() -> None:
    assert [(s.name, s.value) for s in Stage] == [("ORIGINAL", 0), ("OUTPAINTED", 1), ("REPAIRED", 2)]
