"""Cases made from their plans: recordings for the tool, truth and oracle elsewhere."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.simulator import Case, CaseSpec, simulate, truth_text, write_case

from .key import Key
from .mix import RATE, SECONDS, SUBSTEPS, Plan, plan
from .oracle import balances, held_out, without_effects
from .severity import START, UNKNOWN_START, Sized, sized
from .store import Store, whole_folder, write_json, write_text


class NothingToSeeError(RuntimeError):
    """No effect of a plan can be seen as it should be in the robot that was drawn."""


def make(key: Key, name: str, store: Store) -> None:
    """Make a case of the mix and seal it; one that is there already stays."""
    make_planned(key, plan(key, name), store)


def make_planned(key: Key, drawn: Plan, store: Store) -> None:
    """Make the case of a plan and seal it; one that is there already stays.

    The truth is on disk before the case is: what the tool can be given has a truth that it is
    held to.
    """
    name = drawn.name
    if store.made(name) or store.unmade(name).exists():
        return
    try:
        case, oracle = realised(key, drawn)
    except (NothingToSeeError, FloatingPointError) as error:
        write_json(store.unmade(name), {"id": name, "reason": str(error)})
        return
    write_text(store.truth(name), truth_text(case))
    with whole_folder(store.oracle_predictions(name)) as folder:
        write_exact(case, folder)
    write_json(store.oracle(name), oracle)
    with whole_folder(store.case(name)) as folder:
        write_case(case, folder)


def realised(key: Key, drawn: Plan) -> tuple[Case, dict[str, Any]]:
    """The case of a plan, with everything that is said about it in its truth, and the oracle."""
    base = CaseSpec(
        robot=drawn.robot,
        seed=drawn.seed,
        link_encoders=drawn.link_encoders,
        seconds=SECONDS,
        rate=RATE,
        substeps=SUBSTEPS,
        name=drawn.name,
    )
    chosen: list[tuple[str, int | None, Sized]] = []
    for order in drawn.effects:
        taken = {name for name, _, _ in chosen}
        chosen.append(_first_seen(key, drawn, base, [e for e in order if e not in taken]))
    effects = tuple((e, joint, s.size * drawn.severity) for e, joint, s in chosen)
    spec = replace(base, effects=effects)
    case = simulate(spec)
    case.truth.update(
        id=drawn.name,
        suite=drawn.suite,
        kind=drawn.kind,
        severity=drawn.severity,
        link_encoders=drawn.link_encoders,
        spec=asdict(spec),
    )
    alone = [
        {"effect": e, "joint": joint, "size": size, "z_at_1": s.z}
        for (e, joint, size), (_, _, s) in zip(effects, chosen, strict=True)
    ]
    oracle = {"id": drawn.name, "z": balances(case).z, "effects": alone, **held_out(case)}
    return case, oracle


def _first_seen(
    key: Key, drawn: Plan, base: CaseSpec, order: list[str]
) -> tuple[str, int | None, Sized]:
    for effect in order:
        for joint in drawn.joints(key, effect):
            found = sized(base, effect, joint, START.get(effect, UNKNOWN_START))
            if found is not None:
                return effect, joint, found
    raise NothingToSeeError(f"{drawn.name}: no effect can be seen in {drawn.robot}")


def write_exact(case: Case, folder: Path) -> None:
    """Exact signals of the held-out runs, and what robots that lack nothing would give."""
    for r, run in enumerate(case.runs):
        if run.plan.role == "train":
            continue
        columns = {k: v for k, v in run.clean.items() if k == "t" or k.startswith(("tau", "ql"))}
        for kind, values in (
            ("pred", columns),
            ("healthy", without_effects(case, r, tolerances=True)),
            ("nominal", without_effects(case, r, tolerances=False)),
        ):
            np.savez_compressed(folder / f"{kind}_{run.plan.name}.npz", **values)
