"""Fit recordings of real robots by stiffopt and by others.

    python -m benchmarks.identification_peers install [NAME ...]  # each in its own environment
    python -m benchmarks.identification_peers [SET ...]           # results into work/
    python -m benchmarks.identification_peers page                # RESULTS.md of all in work/

Recordings are looked for in STIFFOPT_RECORDINGS (default ../shared/recordings beside the package).
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from benchmarks.environments import Environments
from benchmarks.identification_peers.page import page, section
from benchmarks.identification_peers.samples import predictions, write
from benchmarks.real_peers import Motion, friction_lines, gaussian_process, motions
from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.diagnosis import Diagnosis, fit_by_channel
from stiffopt.discovery.prediction import Prediction, RunProof, compare_predictions, used_samples
from stiffopt.errors import StiffoptError

HERE = Path(__file__).parent
RECORDINGS = Path(
    os.environ.get("STIFFOPT_RECORDINGS", HERE.parents[2] / "shared" / "recordings")
).resolve()
SETS = ("emps", "unisa_ur10", "ur10e", "kuka_kr300", "tx40_first", "dfki_a0815")
PEERS = Environments(
    Path(os.environ.get("STIFFOPT_PEERS", HERE / "environments")),
    {
        "figaroh": ("figaroh==1.0.2", "pin==4.1.0", "numpy==2.4.6"),
        "mujoco": ("mujoco[sysid]==4.0.0", "numpy==2.4.6"),
        "pysindy": ("pysindy==2.1.0", "numpy==2.4.6"),
    },
)
SECONDS = 3600


def one(name: str) -> dict[str, Any]:
    """Residuals of one set by all, as plain data."""
    begin = time.process_time()
    diagnosis = diagnose(RECORDINGS / name, experiment=False)
    spent = time.process_time() - begin
    held_out = list(diagnosis.held_out)
    train, test = motions(
        diagnosis, list(diagnosis.training.recorded), [proof.run for proof in held_out]
    )
    found: dict[str, dict[str, Any]] = {
        "nominal": {"rms": _rms(diagnosis, held_out, "before")},
        "stiffopt": {
            "rms": _rms(diagnosis, held_out, "after"),
            "size": f"{len(diagnosis.findings)} findings",
            "seconds": spent,
        },
    }
    lines = (("friction lines", friction_lines), ("Gaussian process", gaussian_process))
    for label, fitted in lines:
        begin = time.process_time()
        rms = _judged(diagnosis, test, fitted(train, test))
        found[label] = {"rms": rms, "seconds": time.process_time() - begin}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "samples.npz")
        write(diagnosis, train, test, path)
        for label in PEERS.packages:
            found[label] = _asked(label, path)
            torque = found[label].pop("torque", None)
            if torque is not None:
                found[label]["rms"] = _judged(diagnosis, test, predictions(test, torque))
    units = ["N" if joint.prismatic else "N m" for joint in diagnosis.training.constants.joints]
    return {
        "set": name,
        "joints": list(diagnosis.recordings.joints),
        "units": units,
        "torque": _spread(test),
        "bands": list(train[0].bands),
        "found": found,
    }


def _asked(name: str, path: Path) -> dict[str, Any]:
    """Torques of a peer and the size of its model, or why there are none."""
    python = PEERS.python(name)
    if python is None:
        return {"absent": PEERS.absence(name)}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    try:
        done = subprocess.run(
            [str(python), str(HERE / f"{name}_peer.py"), str(path)],
            capture_output=True,
            text=True,
            timeout=SECONDS,
            check=False,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
        )
    except subprocess.TimeoutExpired:
        return {"absent": f"no end in {SECONDS} s"}
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        return {"absent": " ".join(done.stderr.strip().splitlines()[-2:]) or "no answer"}
    return {
        "torque": np.load(path.with_suffix(".npy")),
        "size": json.loads(done.stdout.splitlines()[-1]),
        "seconds": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
    }


def _judged(
    diagnosis: Diagnosis, test: list[Motion], predicted: list[Prediction]
) -> list[float | None]:
    noise = diagnosis.training.noise
    proofs = [
        compare_predictions(each.run, each.velocity, each.nominal, prediction, noise)
        for each, prediction in zip(test, predicted, strict=True)
    ]
    return _rms(diagnosis, proofs, "after")


def _rms(diagnosis: Diagnosis, proofs: list[RunProof], when: str) -> list[float | None]:
    """Of each joint's torque; None where the test runs hold none of it."""
    joints = diagnosis.training.constants.joints
    fits = {
        fit.channel: float(getattr(fit, f"rms_{when}"))
        for fit in fit_by_channel(tuple(proofs), [joint.prismatic for joint in joints])
    }
    return [fits.get(f"torque_{j + 1}") for j in range(len(joints))]


def _spread(test: list[Motion]) -> list[float | None]:
    """Standard deviation of each joint's torque over the samples that count."""
    values: list[list[np.ndarray]] = [[] for _ in range(test[0].run.n)]
    for each in test:
        for kind, j, used in used_samples(each.run, each.velocity):
            if kind == "torque" and used is not None:
                values[j].append(each.run.torque[used, j])
    return [float(np.concatenate(parts).std()) if parts else None for parts in values]


def _refuse(what: str, names: list[str], known: list[str]) -> None:
    """Stop where a name is none of those that there are."""
    unknown = [name for name in names if name not in known]
    if unknown:
        _stop(f"No {what} {', '.join(map(repr, unknown))}: take one of {', '.join(known)}.")


def _stop(sentence: str) -> NoReturn:
    print(sentence, file=sys.stderr)
    sys.exit(2)


def main() -> None:
    """Install peers, or run them."""
    parser = argparse.ArgumentParser(
        prog="benchmarks.identification_peers",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("names", nargs="*", help="sets (all), or install [NAME ...], or page")
    asked = parser.parse_args()
    if asked.names[:1] == ["install"]:
        _refuse("peer", asked.names[1:], list(PEERS.packages))
        PEERS.install(asked.names[1:])
        return
    work = HERE / "work"
    if asked.names == ["page"]:
        stored = [work / f"{name}.json" for name in SETS]
        done = [json.loads(path.read_text()) for path in stored if path.is_file()]
        (HERE / "RESULTS.md").write_text(page(done))
        return
    there = sorted(path.parent.name for path in RECORDINGS.glob("*/recordings.toml"))
    if not there:
        _stop(f"No recordings in {RECORDINGS}: set STIFFOPT_RECORDINGS to their folder.")
    _refuse("set", asked.names, there)
    work.mkdir(exist_ok=True)
    for name in asked.names or SETS:
        try:
            found = one(name)
        except StiffoptError as error:
            _stop(str(error))
        (work / f"{name}.json").write_text(json.dumps(found))
        print(section(found), flush=True)


if __name__ == "__main__":
    main()
