"""Diagnoses of published recordings beside two peers, written to REAL_DATA.md beside this file.

    python benchmarks/real_data.py [SET ...]

Recordings are looked for in STIFFOPT_RECORDINGS (default ../shared/recordings beside the package).
With names only those sets run, and only print. Each set runs in a process of its own; all numbers
of a table are of runs that nothing was fitted to.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any

import numpy as np
from real_claims import (
    CLAIM_PROBABILITY,
    answers_of_cut_runs,
    claimed_names,
    claims,
    remaining_residual,
)
from real_peers import base_parameters, friction_lines, gaussian_process, motions

from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.diagnosis import Diagnosis, fit_by_channel
from stiffopt.discovery.position_fit import loop_values
from stiffopt.discovery.prediction import RunProof, compare_predictions, nrmse
from stiffopt.identification.stiffness import identify_stiffness
from stiffopt.recording.static_set import is_static, load_static_set
from stiffopt.report.diagnosis.mismatch import noise_ceiling_sentence, transfer_sentences
from stiffopt.starter.recording_set import start_recording_set

HERE = Path(__file__).parent
RECORDINGS = Path(
    os.environ.get("STIFFOPT_RECORDINGS", HERE.parent.parent / "shared" / "recordings")
)
MODELS = ("nominal", "friction lines", "base parameters", "Gaussian process", "extended")
HEAD = """# Published recordings

What `stiffopt diagnose` finds in recordings of real robots, and how well the extended model
predicts runs that nothing was fitted to. Beside it three peers that start from the same nominal
inertial model and see the same training runs: friction lines (Coulomb, viscous and an offset of
every joint by plain least squares), base parameters (all inertial parameters, friction lines and
rotors by weighted least squares), and a Gaussian process of the residual (800 samples, scales
chosen by stretches left out) as a black box that names nothing. Peers follow the motion in bands of
their own choice, as they predict stretches of the training runs best. Residuals are root mean
squares of unfiltered channels, torque where the joint moves; *over noise* divides every channel by
its noise. A claim (probability 0.8 and more, beyond friction, rotors and offsets) is *refuted*
where the model fitted without it predicts its channel of the held-out runs better. *Start cut*
diagnoses again with the first 3, 5 and 10 % of each training run left out.
Best of each row in bold.
"""


def main(names: list[str]) -> None:
    """Run the named sets, or all of them and keep the page."""
    if names[:1] == ["--one"]:
        print(json.dumps(one(Path(names[1]))))
        return
    if not RECORDINGS.is_dir():
        sys.exit(f"no recordings at {RECORDINGS}: set STIFFOPT_RECORDINGS")
    sets = [RECORDINGS / name for name in names] or sorted(RECORDINGS.iterdir())
    sections, results = [], {}
    for path in sets:
        results[path.name] = _apart(path)
        sections.append(_section(path.name, results[path.name]))
        print(sections[-1], flush=True)
    summary = _summary(results)
    print(summary)
    if not names:
        page = "\n\n".join([HEAD.rstrip(), summary, *sections])
        (HERE / "REAL_DATA.md").write_text(page + "\n", encoding="utf-8")


def _apart(path: Path) -> dict[str, Any]:
    """Result of a set, from a process of its own."""
    with tempfile.TemporaryFile("w+") as errors:
        done = subprocess.run(
            [sys.executable, __file__, "--one", str(path)],
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            check=False,
        )
        errors.seek(0)
        if done.returncode:
            return {"failed": errors.read().strip().splitlines()[-1]}
    return dict(json.loads(done.stdout.splitlines()[-1]))


def one(path: Path) -> dict[str, Any]:
    """Diagnosis and peers of one set, as plain data."""
    begin, worked = time.perf_counter(), time.process_time()
    if is_static(path):
        return _static(path) | _cost(begin, worked)
    try:
        with tempfile.TemporaryDirectory() as folder:
            diagnosis = diagnose(_described(path, Path(folder) / path.name))
    except Exception as error:  # a set that fails must not hide the others
        traceback.print_exc()
        return {"failed": f"{type(error).__name__} {error}".strip()} | _cost(begin, worked)
    shared = {
        "verdict": diagnosis.verdict,
        "findings": [_finding(diagnosis, k) for k in range(len(diagnosis.findings))],
        "faults": len(diagnosis.faults),
    } | _cost(begin, worked)
    if diagnosis.positions:
        return _simulated(diagnosis) | shared
    held_out = list(diagnosis.held_out)
    train, test = motions(
        diagnosis, list(diagnosis.training.recorded), [proof.run for proof in held_out]
    )
    peers = {
        "friction lines": friction_lines(train, test),
        "base parameters": base_parameters(train, test),
        "Gaussian process": gaussian_process(train, test),
    }
    noise = diagnosis.training.noise
    proofs: dict[str, list[RunProof]] = {"nominal": held_out, "extended": held_out}
    for name, predictions in peers.items():
        proofs[name] = [
            compare_predictions(each.run, each.velocity, proof.before, prediction, noise)
            for each, proof, prediction in zip(test, held_out, predictions, strict=True)
        ]
    remaining, names = remaining_residual(diagnosis), claimed_names(diagnosis)
    return {
        "claims": [
            [
                c.label,
                f"{c.probability:.2f}",
                f"{c.fitted_with:.3g}",
                f"{c.fitted_without:.3g}",
                c.judgement,
            ]
            for c in claims(diagnosis)
        ],
        "cuts": [
            [
                f"{100 * cut.share:.0f} %",
                ", ".join(sorted(cut.names ^ names)) or "none",
                f"{cut.remaining / remaining:.3f}",
                "yes" if cut.agrees(names, remaining) else "no",
            ]
            for cut in answers_of_cut_runs(path)
        ],
        "outside": None if diagnosis.unexplained is None else vars(diagnosis.unexplained),
        "rod": noise_ceiling_sentence(diagnosis),
        "carried_over": transfer_sentences(diagnosis),
        "assumptions": list(diagnosis.assumptions),
        "runs": [
            [f"{proof.run.file} ({proof.run.role})", *(_run_score(proofs[m], k, m) for m in MODELS)]
            for k, proof in enumerate(held_out)
        ],
        "total": [nrmse(proofs[m], _when(m)) for m in MODELS],
        "torque": [nrmse(_torque_only(proofs[m]), _when(m)) for m in MODELS],
        "channels": _channels(diagnosis, proofs),
    } | shared


def _described(path: Path, folder: Path) -> Path:
    """Return a set, or one that `init recording` writes into a folder for recordings without."""
    if (path / "recordings.toml").is_file():
        return path
    (urdf,) = path.glob("*.urdf")
    return start_recording_set(sorted(path.glob("*.csv")), urdf, folder).path


def _simulated(diagnosis: Diagnosis) -> dict[str, Any]:
    """Result of a set without torques: runs simulated from their commands."""
    joints = diagnosis.training.constants.joints
    runs = []
    for run in diagnosis.positions:
        each = [
            1e3 * np.sqrt(np.mean((model - run.measured) ** 2, axis=0))
            for model in (run.before, run.after)
        ]
        name = f"{run.name} ({run.role})"
        pairs = enumerate(zip(*each, strict=True), start=1)
        runs += [[f"{name} joint {j}", *_best(list(pair))] for j, pair in pairs]
    values = loop_values(diagnosis.closed_loop, [joint.prismatic for joint in joints])
    return {
        "positions": runs,
        "values": [
            [
                v["parameter"].replace("_", " "),
                "" if v["joint"] is None else f"joint {v['joint']}",
                f"{v['value']:.3g} ± {v['sd']:.2g} {v['unit']}",
            ]
            for v in values
            if abs(v["value"]) > v["sd"] > 0.0
        ],
    }


def _when(model: str) -> str:
    return "before" if model == "nominal" else "after"


def _run_score(proofs: list[RunProof], k: int, model: str) -> float:
    return nrmse([proofs[k]], _when(model))


def _torque_only(proofs: list[RunProof]) -> list[RunProof]:
    from dataclasses import replace

    return [replace(p, channels=tuple(c for c in p.channels if c.kind == "torque")) for p in proofs]


def _channels(diagnosis: Diagnosis, proofs: dict[str, list[RunProof]]) -> list[list[Any]]:
    prismatic = [joint.prismatic for joint in diagnosis.training.constants.joints]
    fits = {m: fit_by_channel(tuple(proofs[m]), prismatic) for m in MODELS}
    rows: list[list[Any]] = []
    for k, fit in enumerate(fits["nominal"]):
        rms = [getattr(fits[m][k], f"rms_{_when(m)}") for m in MODELS]
        rows.append([f"{fit.channel} [{fit.unit}]", *rms, fit.noise])
    return rows


def _finding(diagnosis: Diagnosis, k: int) -> list[str]:
    finding = diagnosis.findings[k]
    where = f"joint {finding.joint}" if finding.joint else finding.link or "robot"
    parameters = ", ".join(
        f"{p.name} = {p.value:.3g} ± {p.sd:.2g} {p.unit}".rstrip() for p in finding.parameters
    )
    rivals = ", ".join(f"{r.located.label} {r.probability:.2f}" for r in finding.rivals)
    share = f"{100 * finding.variance_explained:.0f} % of {finding.channel}"
    return [
        finding.effect.name,
        where,
        f"{finding.probability:.2f}",
        parameters,
        share,
        rivals or "none",
    ]


def _static(path: Path) -> dict[str, Any]:
    result = identify_stiffness(load_static_set(path))
    return {
        "joints": [
            [
                joint.name,
                joint.status,
                *(_number(v) for v in (joint.stiffness, joint.lower, joint.upper, joint.nominal)),
            ]
            for joint in result.joints
        ],
        "errors": {
            "displacement": result.errors.displacement,
            "published stiffness": result.errors.nominal,
            "least squares, pose left out": result.errors.least_squares_left_out,
            "stiffopt, pose left out": result.errors.left_out,
        },
        "torque": result.torque_dependence.sentence,
    }


def _cost(begin: float, worked: float) -> dict[str, float]:
    return {
        "seconds": time.perf_counter() - begin,
        "processor": time.process_time() - worked,
        "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def _section(name: str, found: dict[str, Any]) -> str:
    """Markdown of one set."""
    parts = [f"## {name}"]
    if "failed" in found:
        return "\n\n".join([*parts, f"Failed: {found['failed']}"])
    parts.append(
        f"{found['processor']:.0f} s of processor time, {found['memory']:.0f} MiB at the most."
    )
    if "joints" in found:
        head = ("joint", "status", "stiffness", "lower", "upper", "published")
        errors = "; ".join(
            f"{k} {1e3 * v:.3f} mm" for k, v in found["errors"].items() if v is not None
        )
        return "\n\n".join(
            [
                *parts,
                _table(head, found["joints"]),
                f"Root mean square: {errors}.",
                f"Torque-dependent stiffness: {found['torque']}",
            ]
        )
    parts.append(f"Verdict: `{found['verdict']}`. Faults of the recordings: {found['faults']}.")
    if found["findings"]:
        head = ("effect", "where", "probability", "parameters", "explains", "confused with")
        parts.append(_table(head, found["findings"]))
    if found.get("claims"):
        head = ("claim", "probability", "its channel with it", "without it", "held-out runs")
        parts.append(_table(head, found["claims"]))
    if "positions" in found:
        parts += [
            "Commands and positions are recorded, no torques: held-out runs are simulated from"
            " their commands and first positions alone.",
            _table(("error of the position [mrad]", "nominal", "extended"), found["positions"]),
            _table(("value of the simulation", "where", "fitted"), found["values"]),
        ]
        return "\n\n".join(parts)
    head = (
        "start cut",
        f"names at P >= {CLAIM_PROBABILITY} that differ",
        "residual over uncut",
        "agrees",
    )
    parts.append(_table(head, found["cuts"]))
    if found["outside"]:
        channels = ", ".join(found["outside"]["channels"])
        depends = ", ".join(found["outside"]["regressors"]) or "nothing that was recorded"
        parts.append(
            f"Outside the catalogue: {channels}, depending on {depends}"
            f" ({100 * found['outside']['gain']:.0f} % of it in recordings left out)."
        )
    if found["rod"]:
        parts.append(found["rod"])
    parts += found["carried_over"]
    rows = [
        ["all channels over noise", *_best(found["total"]), ""],
        ["torque over noise", *_best(found["torque"]), ""],
        *([f"{run} over noise", *_best(values), ""] for run, *values in found["runs"]),
        *([name, *_best(v[:-1]), _number(v[-1])] for name, *v in found["channels"]),
    ]
    parts.append(_table(("residual", *MODELS, "noise"), rows))
    return "\n\n".join(parts)


def _summary(results: dict[str, dict[str, Any]]) -> str:
    """All sets in one table, and refuted claims and agreements counted."""
    rows, claimed, refuted, agreed, cut = [], 0, 0, 0, 0
    for name, found in results.items():
        if "total" not in found:
            continue
        wrong = sum(line[-1] == "refuted" for line in found["claims"])
        same = sum(line[-1] == "yes" for line in found["cuts"])
        claimed, refuted = claimed + len(found["claims"]), refuted + wrong
        agreed, cut = agreed + same, cut + len(found["cuts"])
        rows.append(
            [name, *_best(found["total"]), f"{wrong} of {len(found['claims'])}",
             f"{same} of {len(found['cuts'])}"]
        )  # fmt: skip
    head = ("all channels over noise", *MODELS, "claims refuted", "start cuts that agree")
    counts = f"Claims refuted: {refuted} of {claimed}. Start cuts that agree: {agreed} of {cut}."
    return "\n\n".join(["## All sets", _table(head, rows), counts])


def _best(values: list[float]) -> list[str]:
    least = min(values)
    return [f"**{_number(v)}**" if v == least else _number(v) for v in values]


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"


def _table(head: tuple[str, ...], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


if __name__ == "__main__":
    main(sys.argv[1:])
