"""Solve sparse regressions with pysindy, in an environment of its own: FOLDER SETTINGS."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pysindy

folder, settings = Path(sys.argv[1]), json.loads(sys.argv[2])
for path in sorted(folder.glob("problem_*.npz")):
    with np.load(path) as problem:
        x, y = problem["x"], problem["y"]
    solver = pysindy.STLSQ(threshold=settings["threshold"], alpha=settings["ridge"], max_iter=20)
    try:
        weights = np.ravel(solver.fit(x, y[:, None]).coef_)
    except ValueError:
        # It refuses to end with no term at all.
        weights = np.zeros(x.shape[1])
    np.save(folder / path.name.replace("problem", "weights").replace(".npz", ".npy"), weights)
