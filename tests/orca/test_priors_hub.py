"""Where weights come from: folder, cache, hub; quick and typed when they are nowhere."""

from __future__ import annotations

import logging
import re
import socket
from pathlib import Path
from typing import Any

import huggingface_hub
import pytest
from huggingface_hub import constants

from orca.errors import BadInput, Unavailable
from orca.priors import hub
from orca.priors.hub import DEPTH_ANYTHING_V2_SMALL, DEPTH_PRO, SD15_INPAINTING, ModelAccess, locate

VARIABLE = "ORCA_REVISION_DEPTHPRO_HF"
MODELS = (SD15_INPAINTING, DEPTH_PRO, DEPTH_ANYTHING_V2_SMALL)


def write(folder: Path, names: tuple[str, ...]) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("x")
    return folder


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty hub cache, and a hub that may be asked."""
    hub._hub_problem.cache_clear()
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
    for name in ("HTTPS_PROXY", "https_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.delenv(VARIABLE, raising=False)
    return tmp_path / "cache"


def no_network(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Nothing can be connected to; returns what was tried."""
    tried: list[Any] = []

    def refuse(address: Any, timeout: float) -> None:
        tried.append((address, timeout))
        raise OSError("unreachable")

    monkeypatch.setattr(socket, "create_connection", refuse)
    monkeypatch.setattr(huggingface_hub, "snapshot_download", lambda *_, **__: pytest.fail("asked the hub"))
    return tried


@pytest.mark.parametrize("model", MODELS)
def test_only_safetensors_are_ever_asked_for(model: hub.HubModel) -> None:
    assert any(name.endswith(".safetensors") for name in model.files)
    assert not [name for name in model.files if name.endswith((".bin", ".pt", ".pth", ".ckpt", ".pkl"))]
    assert re.fullmatch(r"[0-9a-f]{40}", model.revision) or (model is DEPTH_PRO and not model.revision)


@pytest.mark.parametrize("name", ["apple/DepthPro-hf", "DepthPro-hf"])
def test_a_weights_folder_in_either_layout(tmp_path: Path, name: str) -> None:
    folder = write(tmp_path / name, DEPTH_PRO.files)
    assert locate(DEPTH_PRO, ModelAccess(tmp_path)) == folder


def test_a_weights_folder_is_the_only_place_looked_at(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(cache / "models--apple--DepthPro-hf" / "snapshots" / "main", DEPTH_PRO.files)
    tried = no_network(monkeypatch)
    with pytest.raises(Unavailable, match="preprocessor_config"):
        locate(DEPTH_PRO, ModelAccess(write(tmp_path / "w" / "DepthPro-hf", DEPTH_PRO.files[:2]).parent))
    assert tried == []


@pytest.mark.parametrize("by_branch", [True, False])
def test_the_hubs_cache_is_used_without_asking_the_hub(
    cache: Path, monkeypatch: pytest.MonkeyPatch, by_branch: bool
) -> None:
    model = DEPTH_PRO if by_branch else DEPTH_ANYTHING_V2_SMALL
    folder = cache / f"models--{model.repo.replace('/', '--')}"
    commit = "0123abcd" if by_branch else model.revision
    snapshot = write(folder / "snapshots" / commit, model.files)
    if by_branch:
        (folder / "refs").mkdir()
        (folder / "refs" / "main").write_text(commit)
    tried = no_network(monkeypatch)
    assert locate(model, ModelAccess()) == snapshot
    assert tried == []


@pytest.mark.parametrize("how", ["option", "environment"])
def test_offline_never_connects(cache: Path, monkeypatch: pytest.MonkeyPatch, how: str) -> None:
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", how == "environment")
    tried = no_network(monkeypatch)
    with pytest.raises(Unavailable) as caught:
        locate(SD15_INPAINTING, ModelAccess(local_files_only=how == "option"))
    assert tried == []
    assert str(cache) in caught.value.given
    assert "unet/diffusion_pytorch_model.safetensors" in caught.value.allowed


def test_an_unreachable_hub_is_tried_once_and_shortly(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tried = no_network(monkeypatch)
    monkeypatch.setenv(VARIABLE, "main")
    for model in MODELS:
        with pytest.raises(Unavailable, match="does not answer"):
            locate(model, ModelAccess())
    assert tried == [(("huggingface.co", 443), 2.0)]


def test_a_hub_without_https_is_not_asked(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(constants, "ENDPOINT", "http://mirror.local")
    tried = no_network(monkeypatch)
    with pytest.raises(Unavailable, match="is not https"):
        locate(DEPTH_ANYTHING_V2_SMALL, ModelAccess())
    assert tried == []


def test_behind_a_proxy_the_proxy_is_tried(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HTTPS_PROXY", "http://proxy.local:3128")
    tried = no_network(monkeypatch)
    with pytest.raises(Unavailable, match="proxy"):
        locate(DEPTH_ANYTHING_V2_SMALL, ModelAccess())
    assert tried[0][0] == ("proxy.local", 3128)


def reachable(monkeypatch: pytest.MonkeyPatch, download: Any) -> None:
    monkeypatch.setattr(hub, "_hub_problem", lambda _: None)
    monkeypatch.setattr(huggingface_hub, "snapshot_download", download)


def test_a_download_is_pinned_limited_and_announced(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    asked: dict[str, Any] = {}

    def download(repo: str, **given: Any) -> str:
        asked.update(given, repo=repo)
        return str(write(tmp_path / "got", SD15_INPAINTING.files))

    reachable(monkeypatch, download)
    with caplog.at_level(logging.WARNING):
        assert locate(SD15_INPAINTING, ModelAccess()) == tmp_path / "got"
    assert asked["repo"] == "stable-diffusion-v1-5/stable-diffusion-inpainting"
    assert asked["revision"] == "8a4288a76071f7280aedbdb3253bdb9e9d5d84bb"
    assert tuple(asked["allow_patterns"]) == SD15_INPAINTING.files
    assert "4300 MB" in caplog.text


def test_a_download_that_fails_or_is_incomplete_is_unavailable(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(repo: str, **_: Any) -> str:
        raise ConnectionError("reset by peer")

    reachable(monkeypatch, broken)
    with pytest.raises(Unavailable, match="reset by peer"):
        locate(DEPTH_ANYTHING_V2_SMALL, ModelAccess())
    reachable(monkeypatch, lambda repo, **_: str(write(tmp_path / "part", DEPTH_ANYTHING_V2_SMALL.files[:1])))
    with pytest.raises(Unavailable, match=r"has no model\.safetensors"):
        locate(DEPTH_ANYTHING_V2_SMALL, ModelAccess())


def test_what_is_not_pinned_is_not_downloaded(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether the hub answers is not even asked; the error says which variable would allow it."""
    monkeypatch.setattr(hub, "_hub_problem", lambda _: pytest.fail("asked the hub"))
    monkeypatch.setattr(huggingface_hub, "snapshot_download", lambda *_, **__: pytest.fail("downloaded"))
    with pytest.raises(Unavailable, match="no commit of it is pinned") as caught:
        locate(DEPTH_PRO, ModelAccess())
    assert VARIABLE in caught.value.fix


@pytest.mark.parametrize(("said", "moves"), [("0123456789abcdef" * 2 + "01234567", False), ("main", True)])
def test_a_commit_or_a_branch_that_the_user_names_is_downloaded(
    tmp_path: Path,
    cache: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    said: str,
    moves: bool,
) -> None:
    asked: dict[str, Any] = {}

    def download(repo: str, **given: Any) -> str:
        asked.update(given)
        return str(write(tmp_path / "got", DEPTH_PRO.files))

    reachable(monkeypatch, download)
    monkeypatch.setenv(VARIABLE, said)
    with caplog.at_level(logging.WARNING):
        assert locate(DEPTH_PRO, ModelAccess()) == tmp_path / "got"
    assert asked["revision"] == said
    assert ("follows the branch main" in caplog.text) == moves


def test_a_pin_is_not_changed_by_the_environment(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(DEPTH_ANYTHING_V2_SMALL.variable, "main")
    assert DEPTH_ANYTHING_V2_SMALL.chosen_revision() == "5426e4f0f36572d16453bbda7a8389317b1bef99"


@pytest.mark.parametrize("said", ["../../etc", "a b", "refs/pr/1", "-x"])
def test_what_is_no_revision_is_refused(cache: Path, monkeypatch: pytest.MonkeyPatch, said: str) -> None:
    monkeypatch.setenv(VARIABLE, said)
    with pytest.raises(BadInput, match=VARIABLE):
        locate(DEPTH_PRO, ModelAccess())
