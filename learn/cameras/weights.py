"""Weights of vision models from a folder that the user names: safetensors alone, no code, nothing fetched."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

from ...sim.base.errors import InputError, shortened
from ...sim.base.extras import install_hint
from ...sim.base.json_file import read_object

KINDS = {"grounding-dino": "Grounding DINO", "sam_hq": "SAM-HQ", "sam2_video": "SAM 2 video"}
"""Models by the ``model_type`` of their config.json."""

REQUIRED = ("grounding-dino", "sam_hq")
MEAN, DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Of colours 0..1 as these models were trained with, where a folder has no preprocessor_config.json."""


def find_models(folder: Path) -> dict[str, Path]:
    """Return the folders of the models in a folder, by ``model_type``.

    Raises:
        InputError: There is no such folder, a model is missing or there twice, has no safetensors or wants code.
    """
    if not folder.is_dir():
        found = "a file" if folder.exists() else "no such folder"
        raise InputError(folder, "", found, "a folder with a folder for each model, as save_pretrained writes them")
    out: dict[str, Path] = {}
    for path in sorted(folder.glob("*/config.json")):
        config = _config(path)
        kind = str(config.get("model_type"))
        if kind not in KINDS:
            continue
        if kind in out:
            raise InputError(folder, path.parent.name, f"a second {KINDS[kind]}", "one of each")
        if "auto_map" in config:
            raise InputError(path, "auto_map", "a model that brings code", "models of the transformers library")
        if not list(path.parent.glob("*.safetensors")):
            others = ", ".join(sorted(p.name for p in path.parent.iterdir() if p.suffix in (".bin", ".pt", ".pth")))
            raise InputError(path.parent, "", others or "no weights", "*.safetensors (pickled weights can run code)")
        out[kind] = path.parent
    for kind in REQUIRED:
        if kind not in out:
            raise InputError(folder, "", f"no {KINDS[kind]}", f"a folder with a config.json of model_type {kind}")
    return out


def _config(path: Path) -> dict[str, Any]:
    return read_object(path, "the configuration of a model")


def digests(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of every file of weights that is used, by its path in the folder.

    Raises:
        InputError: As `find_models`.
    """
    out = {}
    for path in find_models(folder).values():
        for file in sorted(path.glob("*.safetensors")):
            digest = hashlib.sha256()
            with file.open("rb") as data:
                while block := data.read(1 << 20):
                    digest.update(block)
            out[str(file.relative_to(folder))] = digest.hexdigest()
    return out


def import_transformers() -> Any:
    """Return the transformers library, told to fetch nothing and to say little.

    Raises:
        InputError: It is not installed.
    """
    for name in ("HF_HUB_OFFLINE", "TRANSFORMERS_OFFLINE", "HF_HUB_DISABLE_TELEMETRY"):
        os.environ[name] = "1"
    try:
        import transformers
    except ImportError:
        raise InputError("camera", "weights", "no transformers library", install_hint("vision")) from None
    transformers.logging.set_verbosity_error()
    transformers.logging.disable_progress_bar()
    return transformers


def load(kind: Any, folder: Path) -> Any:
    """Return a model of a transformers class from its folder, for inference.

    Raises:
        InputError: The files are damaged, or of another model.
    """
    try:
        model = kind.from_pretrained(folder, local_files_only=True, use_safetensors=True, trust_remote_code=False)
    except Exception as error:  # whatever a damaged file makes the library raise
        raise InputError(folder, "", shortened(f"{type(error).__name__}: {error}"), "files of the model") from None
    return model.eval()


def colours(folder: Path) -> tuple[Any, Any]:
    """Return mean and deviation of colours that a model wants taken off, [3] each, from preprocessor_config.json."""
    import numpy as np

    path = folder / "preprocessor_config.json"
    config = _config(path) if path.exists() else {}
    mean, deviation = config.get("image_mean", MEAN), config.get("image_std", DEVIATION)
    try:
        out = np.array(mean, np.float32), np.array(deviation, np.float32)
        if out[0].shape != (3,) or out[1].shape != (3,) or not (out[1] > 0).all():
            raise ValueError
    except (TypeError, ValueError):
        raise InputError(path, "image_mean, image_std", f"{mean}, {deviation}", "three numbers each") from None
    return out
