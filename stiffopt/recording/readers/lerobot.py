"""Names in LeRobot datasets: the entries of vectors, by meta/info.json."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stiffopt.files import load_json
from stiffopt.recording.readers.checks import find_dataset_info


def vector_names(path: Path, feature: str) -> list[str]:
    """Names of the entries of a vector column in the file's dataset; empty where not given."""
    return _entry_names(_dataset_features(path).get(feature))


def _entry_names(feature: Any) -> list[str]:
    """Names of a feature's entries; some datasets nest them one level deeper."""
    names = feature.get("names") if isinstance(feature, dict) else None
    if isinstance(names, dict):
        names = next(iter(names.values()), None)
    return [str(name) for name in names] if isinstance(names, list) else []


def _dataset_features(path: Path) -> dict[str, Any]:
    found = find_dataset_info(path)
    document = {} if found is None else load_json(found)
    features = document.get("features") if isinstance(document, dict) else None
    return features if isinstance(features, dict) else {}
