"""RESULTS.md of identification beside peers."""

from __future__ import annotations

from typing import Any

import numpy as np

COLUMNS = {
    "nominal": "nominal",
    "friction lines": "friction lines",
    "Gaussian process": "Gaussian process",
    "figaroh": "FIGAROH",
    "mujoco": "mujoco.sysid",
    "pysindy": "pysindy",
    "stiffopt": "stiffopt",
}
HEAD = """# Identification beside peers

`python -m benchmarks.identification_peers` fills this (with `install` before it, which makes the
environments, and `page` after it). Residuals are root mean squares of unfiltered torques where the
joint moves, in runs that nothing was fitted to (where a set is one run split in time: in its later
part). All see the same training runs, the nominal model and no test torque; all but stiffopt follow
the motion of each joint in the band in which friction lines predict stretches of the training runs
best. Best in bold; a set has one to four test runs, hence differences of a few per cent say little.

What each was told by hand, beside URDF and recordings:

- friction lines (least squares): that every joint has Coulomb and viscous friction and an offset;
  Gaussian process: what it may depend on (both are those of [REAL_DATA.md](../REAL_DATA.md));
- FIGAROH 1.0.2 (base parameters): that every joint has Coulomb and viscous friction, rotor inertia
  and an offset; samples of a joint at rest left out. Its own regressor, elimination and QR, rows
  weighed as it weighs them, no physical consistency;
- mujoco.sysid 4.0.0: the parameters: damping, frictionloss, armature and torque offset of every
  joint, pseudo-inertia of every body, with starts and bounds from the sizes of the torques; at most
  30 iterations; `mj_inverse` in place of its rollout, which leaves a closed loop's recording
  within a second; 1200 samples; a least inertia of the last body of two URDFs, which have none
  (kuka_kr300: with it, its compiler refuses a body on the way);
- pysindy 2.1.0: a library (angles, speeds and signs, accelerations and nominal torques of all
  joints, products of the joint's own), threshold and ridge chosen by stretches left out;
- stiffopt: nothing of the set; its catalogue of effects is its authors'. Its findings are of the
  whole diagnosis, with places and standard deviations, and its CPU time is that of all of it.

Link encoders and wind-up (kuka_kr300) are in no peer's model.

One row a set: mean over the joints of residual over the torque's standard deviation."""


def share(found: dict[str, Any], name: str) -> float | None:
    """Mean over joints of residual over the torque's spread; None where there is none."""
    rms = found["found"][name].get("rms")
    if rms is None:
        return None
    pairs = zip(rms, found["torque"], strict=True)
    return float(np.mean([r / s for r, s in pairs if r is not None and s]))


def page(sets: list[dict[str, Any]]) -> str:
    """The whole page."""
    rows = [
        [each["set"], *_best([share(each, name) for name in COLUMNS], percent=True)]
        for each in sets
    ]
    return "\n\n".join([HEAD, _table(["set", *COLUMNS.values()], rows), *map(section, sets)]) + "\n"


def section(found: dict[str, Any]) -> str:
    """Markdown of one set."""
    rows = []
    for j, (joint, unit) in enumerate(zip(found["joints"], found["units"], strict=True)):
        values = [(found["found"][name].get("rms") or {j: None})[j] for name in COLUMNS]
        rows.append([f"{joint} [{unit}]", *_best(values)])
    shares = [share(found, name) for name in COLUMNS]
    rows.append(["mean of residual over spread", *_best(shares, percent=True)])
    spent = [found["found"][name].get("seconds") for name in COLUMNS]
    rows.append(["CPU s", *("" if s is None else f"{s:.2g}" for s in spent)])
    bands = ", ".join(f"{band:g}" for band in found["bands"])
    sizes = [
        f"{label}: {each.get('size') or 'absent, ' + each['absent']}"
        for name, label in COLUMNS.items()
        for each in [found["found"][name]]
        if "size" in each or "absent" in each
    ]
    parts = [f"## {found['set']}", _table(["residual", *COLUMNS.values()], rows)]
    return "\n\n".join([*parts, f"Bands of the peers: {bands} Hz. {'; '.join(sizes)}."])


def _best(values: list[float | None], *, percent: bool = False) -> list[str]:
    known = [value for value in values if value is not None]
    cells = []
    for value in values:
        if value is None:
            cells.append("–")
            continue
        text = f"{100.0 * value:.1f} %" if percent else f"{value:.3g}"
        cells.append(f"**{text}**" if value == min(known) else text)
    return cells


def _table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
