"""A touch model: what free motion needs, a classifier on the features, a threshold; one .npz file without pickle."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ...kernels.touch.features import FEATURES, K, M
from ...sim.base.archive import read_arrays
from ...sim.base.errors import InputError
from ...sim.base.types import Array, IntArray
from .features import features_of
from .forest import Forest, grow_forest
from .free_motion import FreeMotion, fit_free_motion
from .recording import Recording

FORMAT = "bough-touch/1"
Kind = Literal["forest", "network"]
KINDS = ("forest", "network")
#: What a feature is; a file whose features are others is refused.
LAYOUT = f"{FEATURES} a joint, window {M}, smoothed over {K}"
_LARGEST = 1 << 28
_FOREST = ("root", "feature", "child", "value")


@dataclass(frozen=True)
class TouchModel:
    """A classifier of contact for an arm of D joints.

    Attributes:
        free: What its joints need in free motion.
        classifier: A `Forest`, or a `Network` of learn/touch/network.py.
        kind: Which of the two.
        rate: Samples a second that it was trained with [Hz].
        threshold: Probability above which it says contact.
        trained_on: SHA-256 of every recording that it has seen, so that none of them is used as a test.
    """

    free: FreeMotion
    classifier: Any
    kind: Kind
    rate: float
    threshold: float
    trained_on: tuple[str, ...]

    @property
    def num_dofs(self) -> int:
        """Number of joints D."""
        return self.free.num_dofs

    def probability(self, recording: Recording) -> Array:
        """Return the probability of contact in every row of a recording, [T]."""
        out: Array = self.classifier.probability(rows_of(self.free, recording))
        return out

    def with_free_motion(self, free: FreeMotion) -> TouchModel:
        """Return the model for another robot, or the same on another day, by what its own free motion needs."""
        return TouchModel(free, self.classifier, self.kind, self.rate, self.threshold, self.trained_on)

    def write(self, path: Path) -> None:
        """Write the model as .npz."""
        parts = vars(self.classifier)
        if self.kind == "network":
            parts = {"middle": parts["middle"], "width": parts["width"]}
            for n in range(3):
                parts |= {f"weight{n}": self.classifier.weight[n], f"bias{n}": self.classifier.bias[n]}
        np.savez_compressed(
            path, format=FORMAT, layout=LAYOUT, kind=self.kind, rate=self.rate, threshold=self.threshold,
            trained_on=np.array(self.trained_on, dtype="U64"), mean=self.free.mean, noise=self.free.noise,
            **{f"classifier_{k}": v for k, v in parts.items()},
        )  # fmt: skip


def rows_of(free: FreeMotion, recording: Recording) -> Array:
    """Return a recording's features [T, 15 D]."""
    return features_of(free, recording.torque, recording.expected, recording.command, recording.velocity)


def digest(recording: Recording) -> str:
    """Return the SHA-256 of a recording's numbers: the same in another folder, under another name."""
    numbers = np.column_stack([recording.time, recording.torque, recording.velocity])
    return hashlib.sha256(np.ascontiguousarray(numbers).tobytes()).hexdigest()


def train_model(
    recordings: Sequence[Recording], kind: Kind, threshold: float, seed: int, source: str
) -> TouchModel:  # fmt: skip
    """Train on recordings: free motion on rows without contact, the classifier on rows whose label is certain.

    Raises:
        InputError: Too few rows without contact.
    """
    free = fit_free_motion(recordings, source)
    rows = np.concatenate([rows_of(free, r)[r.certain] for r in recordings])
    contact = np.concatenate([r.contact[r.certain] for r in recordings])
    rate = float(np.median([r.rate for r in recordings]))
    seen = tuple(digest(r) for r in recordings)
    return TouchModel(free, _grown(kind, rows, contact, seed), kind, rate, threshold, seen)


def _grown(kind: Kind, rows: Array, contact: IntArray, seed: int) -> Any:
    if kind == "forest":
        return grow_forest(rows, contact, seed)
    from .network import train_network  # torch

    return train_network(rows, contact, seed)


def read_model(path: Path) -> TouchModel:
    """Read a model that `TouchModel.write` wrote.

    Raises:
        InputError: It is missing or no such file; its features are others; its numbers make no model.
    """
    allowed = "a model that bough touch train wrote (model.npz)"
    held: dict[str, Any] = read_arrays(path, allowed, limit=_LARGEST)
    if str(held.get("format")) != FORMAT:
        raise InputError(path, "format", f"'{held.get('format')}'", FORMAT)
    if str(held.get("layout")) != LAYOUT:
        raise InputError(path, "features", f"'{held.get('layout')}'", LAYOUT)
    try:
        model = _unpacked(held)
        _check(model, path)
    except (KeyError, TypeError, IndexError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(path, "", f"arrays that make no model ({error})", allowed) from None
    return model


def _unpacked(held: dict[str, Any]) -> TouchModel:
    kind = str(held["kind"])
    if kind == "forest":
        types = (np.int32, np.int32, np.int32, np.float32)
        classifier: Any = Forest(
            *(held[f"classifier_{n}"].astype(t, casting="safe") for n, t in zip(_FOREST, types, strict=True))
        )
    elif kind == "network":
        from .network import Network

        layers = {n: tuple(held[f"classifier_{n}{k}"].astype(np.float32) for k in range(3)) for n in ("weight", "bias")}
        classifier = Network(held["classifier_middle"], held["classifier_width"], **layers)
    else:
        raise KeyError(f"kind '{kind}'")
    free = FreeMotion(held["mean"].astype(np.float64), held["noise"].astype(np.float64))
    seen = tuple(str(v) for v in held["trained_on"])
    return TouchModel(free, classifier, kind, float(held["rate"]), float(held["threshold"]), seen)  # type: ignore[arg-type]


def _check(model: TouchModel, path: Path) -> None:
    mean, noise = model.free.mean, model.free.noise
    good = mean.ndim == 2 and mean.shape[1] == 5 and noise.shape == (len(mean),) and len(mean) > 0
    if not (good and np.isfinite(mean).all() and np.isfinite(noise).all() and (noise > 0).all()):
        raise InputError(path, "free motion", "numbers that are no friction model", "finite ones, noise above zero")
    if not (0.0 <= model.threshold <= 1.0 and 0.0 < model.rate < np.inf):
        found = f"threshold {model.threshold:g}, rate {model.rate:g} Hz"
        raise InputError(path, "threshold", found, "0 to 1, and a rate above zero")
    model.classifier.check(str(path), FEATURES * model.num_dofs)
