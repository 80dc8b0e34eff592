"""States of long runs as bytes: tensors, numbers and text by name, never anything that runs."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import torch

from ...sim.base.errors import InputError


def packed(state: dict[str, Any]) -> bytes:
    """Return a state as `unpacked` takes it."""
    buffer = io.BytesIO()
    torch.save(state, buffer)
    return buffer.getvalue()


def unpacked(data: bytes, file: Path, what: str, device: str | None = None) -> dict[str, Any]:
    """Return the state that a file's bytes hold.

    Args:
        data: The bytes.
        file: Where they are from.
        what: What they should be, as an error says it.
        device: Where its tensors go; None takes the device that they were on.

    Raises:
        InputError: They hold anything but named tensors, numbers and text.
    """
    try:
        state: dict[str, Any] = torch.load(io.BytesIO(data), map_location=device, weights_only=True)
    except Exception as error:  # torch names no common class for what it refuses to read
        first = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(file, "", f"not {what} ({first[:80]})", "tensors, numbers and text") from None
    if not isinstance(state, dict):
        raise InputError(file, "", f"not {what} ({type(state).__name__})", "named tensors, numbers and text")
    return state
