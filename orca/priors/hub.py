"""Where the weights of learned priors come from: a folder, the hub's cache, or the hub. Always safetensors."""

from __future__ import annotations

import logging
import os
import re
import socket
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from urllib.parse import urlsplit

from orca.errors import BadInput, Unavailable

__all__ = ["DEPTH_ANYTHING_V2_SMALL", "DEPTH_PRO", "SD15_INPAINTING", "HubModel", "ModelAccess", "locate"]

_log = logging.getLogger(__name__)

PROBE_SECONDS = 2.0  # a hub that has not answered by then counts as unreachable


@dataclass(frozen=True)
class ModelAccess:
    """How learned priors get at their weights, and where they run.

    Attributes:
        weights_dir: folder that holds one folder per model (`HubModel.repo` or its last part). With it, neither the
            hub nor its cache is looked at.
        local_files_only: never download; the hub's cache on this machine still counts. ``HF_HUB_OFFLINE=1`` says
            the same.
        device: "cpu" or "cuda".
    """

    weights_dir: Path | None = None
    local_files_only: bool = False
    device: str = "cpu"

    def offline(self) -> ModelAccess:
        """The same without downloads."""
        return ModelAccess(self.weights_dir, True, self.device)


@dataclass(frozen=True)
class HubModel:
    """A model of the Hugging Face hub.

    Attributes:
        title: its name for people.
        repo: OWNER/NAME on the hub.
        revision: the commit that is downloaded; empty where none could be verified: then nothing is downloaded unless
            `variable` says what.
        files: every file that is needed; nothing else is downloaded. Weights are safetensors: nothing is unpickled.
        megabytes: about how much that is, said before a download starts.
    """

    title: str
    repo: str
    revision: str
    files: tuple[str, ...]
    megabytes: int

    @property
    def variable(self) -> str:
        """Of the environment: the commit, or branch, to download of a model without a pinned one."""
        return "ORCA_REVISION_" + re.sub(r"[^A-Z0-9]", "_", self.repo.rpartition("/")[2].upper())

    def chosen_revision(self) -> str | None:
        """The pinned commit, else what the environment says, else None. Raises `BadInput` for what is no revision."""
        if self.revision:
            return self.revision
        said = os.environ.get(self.variable, "").strip()
        if said and not re.fullmatch(r"\w[\w.-]{0,99}", said):
            raise BadInput(f"{self.variable}='{said}'", "a commit (40 hex digits) or a branch", "correct or unset it")
        return said or None

    def missing_in(self, folder: Path) -> list[str]:
        """Needed files that ``folder`` does not have."""
        return [name for name in self.files if not (folder / name).is_file()]


SD15_INPAINTING = HubModel(
    "Stable Diffusion 1.5 inpainting",
    "stable-diffusion-v1-5/stable-diffusion-inpainting",
    "8a4288a76071f7280aedbdb3253bdb9e9d5d84bb",
    (
        "model_index.json",
        "scheduler/scheduler_config.json",
        "text_encoder/config.json",
        "text_encoder/model.safetensors",
        "tokenizer/merges.txt",
        "tokenizer/tokenizer_config.json",
        "tokenizer/vocab.json",
        "unet/config.json",
        "unet/diffusion_pytorch_model.safetensors",
        "vae/config.json",
        "vae/diffusion_pytorch_model.safetensors",
    ),
    4300,
)

_TRANSFORMERS_FILES = ("config.json", "model.safetensors", "preprocessor_config.json")

DEPTH_PRO = HubModel(
    "Depth Pro",
    "apple/DepthPro-hf",
    "",  # no commit of this repository could be verified when this was written
    _TRANSFORMERS_FILES,
    1900,
)

DEPTH_ANYTHING_V2_SMALL = HubModel(
    "Depth Anything V2 Small",
    "depth-anything/Depth-Anything-V2-Small-hf",
    "5426e4f0f36572d16453bbda7a8389317b1bef99",
    _TRANSFORMERS_FILES,
    100,
)


def locate(model: HubModel, access: ModelAccess) -> Path:
    """The folder with all of a model's files: in ``weights_dir`` if given, else the hub's cache, else downloaded.

    Never waits long for a network that is not there: whether the hub answers is tried once, for two seconds. A model
    without a pinned commit is not downloaded unless its variable names one, or a branch: a branch moves, and with it
    the results.

    Raises:
        Unavailable: names the files that are missing and where they were looked for.
        BadInput: the variable holds no revision.
    """
    if access.weights_dir is not None:
        return _in_weights_dir(model, access.weights_dir)
    try:
        from huggingface_hub import constants
    except ImportError as error:
        raise Unavailable(
            f"{model.title}: the package huggingface_hub is not installed",
            "the optional dependencies 'models'",
            "pip install 'orca-nvs[models]'",
        ) from error
    revision, cache = model.chosen_revision(), constants.HF_HUB_CACHE
    cached = _in_cache(model, Path(cache), revision or "main")
    if cached is not None:
        return cached
    if access.local_files_only or constants.HF_HUB_OFFLINE:
        raise _unavailable(model, f"not in the hub's cache {cache}, and downloads are off")
    if revision is None:
        first = f"set {model.variable} to a commit (or to main, which moves), "
        raise _unavailable(model, f"not in the hub's cache {cache}, and no commit of it is pinned", first)
    problem = _hub_problem(constants.ENDPOINT)
    if problem is not None:
        raise _unavailable(model, f"not in the hub's cache {cache}, and {problem}")
    return _downloaded(model, revision, constants.ENDPOINT)


def _downloaded(model: HubModel, revision: str, endpoint: str) -> Path:
    from huggingface_hub import snapshot_download

    _log.warning("downloading %s (about %d MB) from %s, once", model.title, model.megabytes, endpoint)
    if not re.fullmatch(r"[0-9a-f]{40}", revision):
        _log.warning("%s follows the branch %s: what it is may change", model.title, revision)
    try:
        found = snapshot_download(model.repo, revision=revision, allow_patterns=list(model.files), etag_timeout=5)
    except Exception as error:
        # The hub's client raises errors of several libraries; whichever it was, there are no weights.
        raise _unavailable(model, f"the download failed ({type(error).__name__}: {str(error)[:200]})") from error
    missing = model.missing_in(Path(found))
    if missing:
        raise _unavailable(model, f"the hub's repository has no {', '.join(missing)}")
    return Path(found)


def _in_weights_dir(model: HubModel, weights_dir: Path) -> Path:
    places = (weights_dir / model.repo, weights_dir / model.repo.rpartition("/")[2])
    for place in places:
        if not model.missing_in(place):
            return place
    nearest = min(places, key=lambda place: len(model.missing_in(place)))
    raise Unavailable(
        f"{model.title}: {', '.join(model.missing_in(nearest))} not in {nearest}",
        f"the files of huggingface.co/{model.repo} in {places[0]} or {places[1]}",
        f"hf download {model.repo} --revision {model.revision or 'COMMIT'} --local-dir {places[0]}, or leave out "
        "--weights-dir",
    )


def _in_cache(model: HubModel, cache: Path, revision: str) -> Path | None:
    """The model's snapshot in the hub's cache, if it is complete. Reads files only, so it takes no time."""
    folder = cache / f"models--{model.repo.replace('/', '--')}"
    reference = folder / "refs" / revision  # a branch is a file that holds its commit
    commit = reference.read_text(encoding="ascii").strip() if reference.is_file() else revision
    snapshot = folder / "snapshots" / commit
    return None if model.missing_in(snapshot) else snapshot


@lru_cache(maxsize=4)
def _hub_problem(endpoint: str) -> str | None:
    """Why the hub is not asked, or None. Tried once per process; through a proxy, whether that answers."""
    if urlsplit(endpoint).scheme != "https":
        return f"{endpoint} is not https"
    proxy = next((os.environ[k] for k in ("HTTPS_PROXY", "https_proxy", "ALL_PROXY") if os.environ.get(k)), None)
    address = urlsplit(proxy or endpoint)
    port = address.port or (443 if address.scheme == "https" else 80)
    try:
        with socket.create_connection((address.hostname or "", port), timeout=PROBE_SECONDS):
            return None
    except OSError as error:
        return f"{address.hostname} does not answer ({error})"


def _unavailable(model: HubModel, why: str, first: str = "") -> Unavailable:
    return Unavailable(
        f"{model.title}: {why}",
        f"{', '.join(model.files)} of huggingface.co/{model.repo}",
        f"{first}let it download (about {model.megabytes} MB), or give --weights-dir DIR with DIR/{model.repo}/",
    )
