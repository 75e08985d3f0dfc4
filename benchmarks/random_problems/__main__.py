"""Solve random problems, one JSON line each; what has a line is not solved again.

    python -m benchmarks.random_problems [--feasible 200] [--infeasible 60] [--seconds S]
        [--seed 14] [--every 1] [--work FOLDER] [--page] [--fresh FOLDER]

`--seconds` stops after the problem that is under way then. `--page` writes RANDOM.md. Another seed
draws other problems that can be met, into a folder of its own (`work/seed_15`), to be named by
`--fresh` for the page; `--every 5` takes each fifth.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.random_problems.draw import HERE, SEED, feasible, infeasible
from stiffopt.certificate.assess import assess
from stiffopt.certificate.objective_value import is_maximised
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.errors import StiffoptError
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.solution import Solution
from stiffopt.solver.solve import solve

# Instants of the check, many times those of the certificate.
INSTANTS = 30_001
PAGE = HERE.parent / "RANDOM.md"


def solved(problem: TrajectoryProblem) -> dict[str, Any]:
    """What is to be known of a solve."""
    wall, cpu = time.perf_counter(), time.process_time()
    found: Solution | None = None
    try:
        found = solve(problem, throw=False)
        told = {"status": str(found.status), "message": found.message}
    except StiffoptError as error:
        told = {"status": "refused", "message": str(error)}
    told |= {"title": problem.title}
    record: dict[str, Any] = dict(told)
    record |= {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu}
    if found is None:
        return record
    record["iterations"] = found.solver.iterations
    record["stages"] = [f"{h['iterations']} {h['status']}" for h in found.solver.homotopy]
    if found.objective is not None:
        record["objective"] = found.objective.value
    if found.status.usable and found.trajectory is not None and found.assessment is not None:
        record["certified"] = found.assessment.worst_violation.value
        times = np.linspace(0.0, found.assessment.duration, INSTANTS)
        worst = assess(problem, found.trajectory, times=times).worst_violation
        record["fine"], record["fine_limit"] = worst.value, worst.limit
    strict = found.strict_baseline
    if strict is not None and strict.feasible and strict.objective is not None:
        record["baseline"] = strict.objective
        record["maximised"] = is_maximised(problem)
    return record


def worse_than_baseline(record: dict[str, Any]) -> bool:
    """Whether a baseline that keeps all limits is better by more than limits may be exceeded."""
    if "baseline" not in record or "objective" not in record:
        return False
    sign = -1.0 if record["maximised"] else 1.0
    own, other = record["objective"], record["baseline"]
    return bool(sign * (own - other) > CERTIFICATE_TOLERANCE * max(abs(own), abs(other)))


def named(record: dict[str, Any]) -> bool:
    """Whether an answer names the limit that forbids the problem."""
    return str(record["limit"]).replace("_", " ") in str(record["message"]).replace("_", " ")


def page(good: list[dict[str, Any]], bad: list[dict[str, Any]], fresh: list[dict[str, Any]]) -> str:
    """Results of all that were solved, and of those of another seed."""
    ends = Counter(r["status"] for r in bad)
    slow = max((r["wall"] for r in bad), default=np.nan)
    lines = [
        "# Random problems",
        "",
        "`python -m benchmarks.random_problems` draws them: UR10, ER3A-C60, a two-link and a"
        " seven-axis arm in turn, random ends and payloads, all objectives in turn, all limits of"
        " the robots. Each that can be met has a quintic motion that keeps every limit, at its"
        " duration or half of it; each that cannot asks a third of what its rows need at least.",
        "",
        _origin([*good, *bad]),
        "",
        *_table(good, 200),
        f"| cannot be met | {len(bad)} | 60 |",
        f"| how they ended | {', '.join(f'{k} {n}' for k, n in ends.most_common())} | |",
        f"| with the limit named that forbids them | {sum(map(named, bad))} | all |",
        f"| longest of them, seconds | {slow:.1f} | 300 |",
        *_listed("Not optimal", [r for r in good if r["status"] != "optimal"]),
        *_listed("Not named", [r for r in bad if not named(r)]),
    ]
    if fresh:
        lines += [
            "",
            "## Of another seed",
            "",
            _origin(fresh),
            "",
            *_table(fresh, 40),
            *_listed("Not optimal", [r for r in fresh if r["status"] != "optimal"]),
        ]
    return "\n".join(lines) + "\n"


def _origin(records: list[dict[str, Any]]) -> str:
    """What records say of the code that solved them."""
    counts = Counter(r.get("commit", "") for r in records)
    unknown = counts.pop("", 0)
    told = [f"{n} at {commit}" for commit, n in counts.items()]
    if unknown:
        told.append(f"{unknown} at commits that their records do not name")
    return f"Solved: {', '.join(told) or 'none'}."


def commit() -> str:
    """The commit that solves, with a plus where files were changed since; "" outside of git."""
    git = ["git", "-C", str(HERE), "describe", "--always", "--exclude=*", "--dirty=+"]
    try:
        return subprocess.run(git, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""


def other_seeds(records: list[dict[str, Any]], seed: int) -> set[int]:
    """Seeds of records that are of another one; older records name none."""
    return {r["seed"] for r in records if r.get("seed", seed) != seed}


def _table(good: list[dict[str, Any]], wanted: int) -> list[str]:
    """Lines of a table about problems that can be met."""
    counts = Counter(r["status"] for r in good)
    optimal = [r for r in good if r["status"] == "optimal"]
    exceeded = [r for r in optimal if r["fine"] > CERTIFICATE_TOLERANCE]
    worse = [r for r in optimal if worse_than_baseline(r)]
    times = np.array([r["cpu"] for r in good] or [np.nan])
    return [
        "| what | measured | wanted |",
        "| --- | --- | --- |",
        f"| can be met, solved | {len(good)} | {wanted} |",
        f"| of them optimal | {len(optimal)} ({len(optimal) / max(len(good), 1):.1%}) |"
        " at least 99 % |",
        f"| how they ended | {', '.join(f'{k} {n}' for k, n in counts.most_common())} | |",
        f"| optimal, and over a limit by more than 0.5 % on {INSTANTS} instants |"
        f" {len(exceeded)} | 0 |",
        f"| optimal, and worse than a baseline that keeps the limits | {len(worse)} | 0 |",
        f"| CPU seconds, median / 90 % / most | {np.median(times):.1f} /"
        f" {np.quantile(times, 0.9):.1f} / {times.max():.1f} | |",
    ]


def _listed(what: str, records: list[dict[str, Any]]) -> list[str]:
    """Lines that say of each how it ended."""
    if not records:
        return []
    told = [f"- {r['title']}: {r['status']}. {r['message'][:200]}" for r in records]
    return ["", f"{what}:", "", *told]


def read(path: Path) -> list[dict[str, Any]]:
    """The lines so far; one that a kill cut short is left out."""
    found = []
    for line in path.read_text().splitlines() if path.is_file() else []:
        try:
            found.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return found


def main() -> None:
    """Solve what is not solved yet."""
    parser = argparse.ArgumentParser(prog="benchmarks.random_problems", description=__doc__)
    parser.add_argument("--feasible", type=int, default=200)
    parser.add_argument("--infeasible", type=int, default=60)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--work", type=Path, help="default: work, of another seed work/seed_N")
    parser.add_argument("--page", action="store_true")
    parser.add_argument("--fresh", type=Path)
    asked = parser.parse_args()
    begin = time.perf_counter()
    if asked.work is None:
        asked.work = HERE / "work" / ("" if asked.seed == SEED else f"seed_{asked.seed}")
    asked.work.mkdir(parents=True, exist_ok=True)
    files = {"feasible": asked.work / "feasible.jsonl", "infeasible": asked.work / "bad.jsonl"}
    if others := other_seeds(read(files["feasible"]), asked.seed):
        parser.error(f"{files['feasible']} is of seed {others}: give another --work.")
    at = commit()
    done = {kind: {r["number"] for r in read(path)} for kind, path in files.items()}
    drawn = range(0, asked.feasible, asked.every)
    todo = [("feasible", n) for n in drawn if n not in done["feasible"]]
    todo += [("infeasible", n) for n in range(asked.infeasible) if n not in done["infeasible"]]
    # In the order of their numbers, so that a part of them is of both kinds.
    for kind, number in sorted(
        todo, key=lambda each: each[1] * (1 if each[0] == "feasible" else 3)
    ):
        if time.perf_counter() - begin > asked.seconds:
            break
        if kind == "feasible":
            record = solved(feasible(number, asked.seed)) | {"seed": asked.seed}
        else:
            problem, limit = infeasible(number)
            record = solved(problem) | {"limit": limit}
        record |= {"number": number, "commit": at}
        with files[kind].open("a") as stream:
            stream.write(json.dumps(record, default=float) + "\n")
        print(f"{record['title']}: {record['status']} {record['cpu']:.1f} s", flush=True)
    if asked.page:
        fresh = [] if asked.fresh is None else read(asked.fresh / "feasible.jsonl")
        PAGE.write_text(page(read(files["feasible"]), read(files["infeasible"]), fresh))


if __name__ == "__main__":
    main()
