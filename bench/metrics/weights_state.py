"""Reads a state dict that others saved: tensors only, whatever else such a file may hold."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from orca.errors import BadInput

__all__ = ["read_state"]


def read_state(path: Path, what: str, source: str = "") -> dict[str, Any]:
    """The tensors of a file of ``torch.save``, by name; pyiqa's files hold them below ``params``.

    Args:
        path: the file; nothing in it is run.
        what: what it should be, for the errors.
        source: where to get it again, if that is known.

    Returns:
        Name -> tensor on the CPU.

    Raises:
        BadInput: it cannot be read, or is no dictionary of tensors.
    """
    import torch

    try:
        found = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # its unpickler works through what the file says, and fails as that makes it fail
        raise _broken(path, f"cannot be read ({type(error).__name__}: {str(error)[:200]})", what, source) from error
    state = found.get("params", found) if isinstance(found, dict) else found
    if not isinstance(state, dict) or not all(
        isinstance(name, str) and isinstance(tensor, torch.Tensor) for name, tensor in state.items()
    ):
        raise _broken(path, "is no dictionary of tensors", what, source)
    return state


def _broken(path: Path, how: str, what: str, source: str) -> BadInput:
    return BadInput(f"{path} {how}", what, f"get it again{f' from {source}' if source else ''}")
