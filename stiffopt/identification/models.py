"""Models of how joints wind up under static load, each as columns that are linear in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiffopt.identification.rows import StaticRows, Windup

EXPONENTS = (0.14, 0.3, 0.5)
# Torque at which tanh bends, over the joint's root mean square torque.
BENDS = (0.05, 0.1, 0.2, 0.5)


@dataclass(frozen=True, kw_only=True, eq=False)
class WindupForm:
    """One form that a model can take, chosen by the poses that it is fitted to.

    Parameters
    ----------
    label : str
    columns : array (m, 3, p)
        All columns, those of the constant compliances first.
    windup : function or None
        Added wind-up for a factor of one.
    """

    label: str
    columns: np.ndarray
    windup: Windup | None = None


@dataclass(frozen=True)
class Family:
    """A model of the wind-up: one form of it, or several to choose from."""

    name: str
    formula: str
    candidate: bool
    shapes: tuple[WindupForm, ...]


def families(rows: StaticRows, kept: np.ndarray) -> list[Family]:
    """Constant compliance, its rival without torque, and the torque-dependent candidates.

    Parameters
    ----------
    rows : StaticRows
    kept : array (k,) of int
        Joints (from 0) that get parameters.
    """
    constant = rows.compliance_columns()[:, :, kept]
    m = len(constant)
    both = np.broadcast_to(np.hstack([np.eye(3), -np.eye(3)]), (m, 3, 6))
    found = [
        Family("constant", "c s", False, (WindupForm(label="", columns=constant),)),
        Family(
            "constant, sensor offset",
            "c s, displacement + x0",
            False,
            (WindupForm(label="", columns=np.concatenate([constant, both], axis=2)),),
        ),
    ]
    size = np.sqrt(np.mean(np.square(rows.load), axis=0))
    powers = [(f"q = {q:g}", _power(q)) for q in EXPONENTS]
    bends = [(f"s0 = {share:g} of rms s", _tanh(share * size)) for share in BENDS]
    preloaded = rows.difference and rows.weight is not None and bool(np.any(rows.weight))
    for on_weight in (False, True) if preloaded else (False,):
        place = ", on the weight" if on_weight else ""
        for name, formula, laws in (
            ("contact", "c s + b |s|^q sign s", powers),
            ("tanh", "c s + b tanh(s / s0)", bends),
        ):
            shapes = tuple(_shape(rows, kept, constant, *law, on_weight) for law in laws)
            found.append(Family(name + place, formula, True, shapes))
    return found


def _shape(
    rows: StaticRows,
    kept: np.ndarray,
    constant: np.ndarray,
    label: str,
    law: Windup,
    on_weight: bool,
) -> WindupForm:
    added = rows.windup_columns(law, on_weight=on_weight)[:, :, kept]
    return WindupForm(label=label, columns=np.concatenate([constant, added], axis=2), windup=law)


def _power(exponent: float) -> Windup:
    return lambda s: np.sign(s) * np.abs(s) ** exponent


def _tanh(bend: np.ndarray) -> Windup:
    bend = np.where(bend > 0.0, bend, 1.0)
    return lambda s: np.tanh(s / bend)
