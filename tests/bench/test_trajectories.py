"""Trajectories as data: hashes, files, evaluated frames, first difference."""

from __future__ import annotations

import dataclasses
import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from bench.trajectories import (
    Trajectory,
    build_trajectory,
    evenly_spaced,
    first_difference,
    from_poses,
    list_trajectories,
    load_trajectory,
    save_trajectory,
)
from orca.camera import Camera
from orca.errors import BadInput, Unknown
from orca.paths import PATHS, swing

CAMERA = Camera.from_fov(64, 48, 60)


def test_every_listed_name_builds() -> None:
    listed = list_trajectories()
    assert list(listed) == list(PATHS)
    hashes = {build_trajectory(name, CAMERA, frames=10).sha256 for name in listed}
    assert len(hashes) == len(listed)
    assert all(text and "\n" not in text for text in listed.values())


def test_unknown_name_and_default_length() -> None:
    with pytest.raises(Unknown, match="did you mean 'vistadream'"):
        build_trajectory("vistadreem", CAMERA)
    assert len(build_trajectory("vistadream", CAMERA)) == 250


def test_the_hash_is_fixed_and_sees_every_field() -> None:
    base = build_trajectory("swing", CAMERA, 12)
    assert base.sha256 == build_trajectory("swing", CAMERA, 12).sha256
    pose = base.world_to_camera.copy()
    pose[7, 0, 3] += 1e-8
    K = base.K.copy()
    K[7, 0, 0] += 1e-8
    changed: list[dict[str, object]] = [
        {"name": "other"},
        {"unit": "m"},
        {"width": 65},
        {"height": 49},
        {"world_to_camera": pose},
        {"K": K},
    ]
    hashes = {dataclasses.replace(base, **change).sha256 for change in changed}  # type: ignore[arg-type]
    assert len(hashes | {base.sha256}) == len(changed) + 1


def test_a_file_keeps_the_hash(tmp_path: Path) -> None:
    path = tmp_path / "new" / "t.json"
    base = build_trajectory("orbit", CAMERA, 9)
    save_trajectory(base, path)
    assert load_trajectory(path).sha256 == base.sha256
    assert build_trajectory(str(path), CAMERA).sha256 == base.sha256


def test_a_file_for_another_image_size_is_refused(tmp_path: Path) -> None:
    save_trajectory(build_trajectory("orbit", CAMERA, 9), tmp_path / "t.json")
    with pytest.raises(BadInput, match="64x48 pixels"):
        build_trajectory(str(tmp_path / "t.json"), Camera.from_fov(32, 48, 60))


def test_broken_files(tmp_path: Path) -> None:
    with pytest.raises(BadInput):
        load_trajectory(tmp_path / "none.json")
    document = build_trajectory("orbit", CAMERA, 9).to_json()
    for broken in ({"world_to_camera": "x"}, {"K": [[1.0]]}, {"width": "wide"}):
        (tmp_path / "b.json").write_text(json.dumps(document | broken))
        with pytest.raises(BadInput):
            load_trajectory(tmp_path / "b.json")


def test_published_cameras_are_read_as_they_are(data_root: Path) -> None:
    loaded = load_trajectory(data_root / "vistadream" / "cameras" / "car.json")
    assert (loaded.name, len(loaded), loaded.fps, loaded.unit) == ("vistadream", 250, 20.0, "R")


def test_evenly_spaced_by_hand() -> None:
    assert evenly_spaced(5, 3) == (0, 2, 4)
    assert evenly_spaced(11, 4) == (0, 3, 7, 10)  # 0, 3.33, 6.67, 10
    assert evenly_spaced(99) == tuple(range(0, 99, 2))
    assert evenly_spaced(50) == tuple(range(50))
    assert evenly_spaced(7) == tuple(range(7))
    published = evenly_spaced(250)
    assert (len(published), published[:3], published[-1]) == (50, (0, 5, 10), 249)


@pytest.mark.parametrize("n", [1, 2, 49, 51, 60, 250, 1000])
def test_evenly_spaced_is_strictly_increasing_from_first_to_last(n: int) -> None:
    indices = evenly_spaced(n)
    assert indices[0] == 0
    assert indices[-1] == n - 1
    assert all(a < b for a, b in itertools.pairwise(indices))


def test_evenly_spaced_of_nothing() -> None:
    for arguments in ((0, 50), (10, 0)):
        with pytest.raises(BadInput):
            evenly_spaced(*arguments)


def changed_at(base: Trajectory, frame: int, by: float) -> Trajectory:
    poses = base.world_to_camera.copy()
    poses[frame, 1, 3] += by
    return dataclasses.replace(base, world_to_camera=poses)


def test_first_difference() -> None:
    base = from_poses("a", swing(10), CAMERA)
    assert first_difference(base, base) is None
    assert first_difference(base, dataclasses.replace(base, name="b")) is None
    assert first_difference(base, changed_at(base, 6, 1e-3)) == 6
    assert first_difference(base, changed_at(base, 6, 1e-12)) is None
    assert first_difference(base, base.subset(range(4))) == 4
    assert first_difference(base.subset(range(4)), base) == 4
    assert first_difference(changed_at(base, 2, 1.0), base.subset(range(4))) == 2
    assert first_difference(base, dataclasses.replace(base, unit="m")) == 0
    assert first_difference(base, dataclasses.replace(base, width=63)) == 0
    K = base.K.copy()
    K[3, 0, 2] += 0.5
    assert first_difference(base, dataclasses.replace(base, K=K)) == 3


def test_first_difference_agrees_with_the_hash() -> None:
    base = from_poses("a", swing(10), CAMERA)
    other = changed_at(base, 9, 2e-9)
    assert (first_difference(base, other) is None) == (base.sha256 == other.sha256)
    assert first_difference(base, other) == 9
    assert np.abs(base.world_to_camera - other.world_to_camera).max() < 3e-9
