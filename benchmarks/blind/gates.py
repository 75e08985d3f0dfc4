"""Gates of a diagnosis, each of which can be taken out, and notice of where one acts.

Gates are taken out here, from outside, so that the tool itself has no switch for them.
"""

# ruff: noqa: E501  one gate a line
from __future__ import annotations

import dataclasses
import functools
import importlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any
from unittest import mock

import numpy as np

_SEARCH, _JUDGING = "stiffopt.discovery.search", "stiffopt.discovery.judging"
_ENTRY = (f"{_SEARCH}.search", f"{_SEARCH}.model_changes")


@dataclass(frozen=True, kw_only=True)
class Gate:
    """A step of the diagnosis that can be taken out.

    Parameters
    ----------
    name : str
    words : str
        What it does, for the table.
    places : tuple of str
        Names that call it, "module:name" or "module:class.name".
    without : callable
        (the gate, *arguments) -> its result without it.
    acts : callable, optional
        (result, *arguments) -> True where it changed something. Default: its result differs from
        that without it.
    """

    name: str
    words: str
    places: tuple[str, ...]
    without: Callable[..., Any]
    acts: Callable[..., bool] | None = None


def _keys(effects: Sequence[Any]) -> list[Any]:
    return [each.key[:-1] for each in effects]


def _differs(one: Any, other: Any) -> bool:
    """Return True unless two results are the same objects or equal numbers."""
    if isinstance(one, tuple | list) and isinstance(other, tuple | list):
        pairs = zip(one, other, strict=False)
        return len(one) != len(other) or any(_differs(a, b) for a, b in pairs)
    if isinstance(one, np.ndarray):
        return not np.array_equal(one, other)
    return one is not other and (not isinstance(one, float | int | str) or one != other)


def _entry_without(**limits: float) -> Callable[..., bool]:
    """Return the entry test with other thresholds."""

    def test(gate: Callable[..., bool], candidate: Any, scorer: Any) -> bool:
        from stiffopt.discovery.search import joint_fit

        with mock.patch.multiple(joint_fit, **limits):
            return gate(candidate, scorer)

    return test


def _all(_: Any, comparison: Any, effects: Sequence[Any], *__: Any) -> list[Any]:
    return list(effects)


def _ranked_only(gate: Any, comparison: Any, current: Any, *rest: Any, **_: Any) -> Any:
    from stiffopt.discovery.search.rivals import rank_effects

    return current, rank_effects(current, *rest)


def _exchanged(found: Any, comparison: Any, current: Any, effects: Any, *_: Any, **__: Any) -> bool:
    return _keys([r.located for r in found[1]]) != _keys(effects)


def _keep_found(gate: Any, result: Any) -> Any:
    _, left = gate(result)
    return result.selected, left


def _keep_all(_: Any, selected: Any, estimated: Any, *__: Any) -> Any:
    return estimated(selected)


def _dropped(found: Any, selected: Any, *_: Any) -> bool:
    return len(found[0]) != len(selected)


def _always(value: Any) -> Callable[..., Any]:
    return lambda *_, **__: value


def _gains_with(**values: float) -> Callable[..., Any]:
    """Return the gains in folds left out with other values."""
    return lambda gate, *given: tuple(dataclasses.replace(g, **values) for g in gate(*given))


def _third(*given: Any) -> Any:
    """Return the estimate among (gate, training, comparison, estimate)."""
    return given[-1]


_PREDICTIVE = tuple(f"{each}:select_predictive" for each in _ENTRY)
_PASSES = tuple(f"{each}:passes_thresholds" for each in _ENTRY)
_DIAGNOSE, _CONCLUSIONS = "stiffopt.discovery.diagnose", "stiffopt.discovery.conclusions"
_TRAINING = "stiffopt.discovery.search_training"

GATES = tuple(
    Gate(name=name, words=words, places=places, without=without, acts=acts)
    for name, words, places, without, acts in (
        ("share", "entry: share of the residual", _PASSES, _entry_without(NAMED_SHARE=-1.0), None),
        ("relief", "entry: relief of nominal values", _PASSES, _entry_without(PRIOR_RELIEF_SHARE=np.inf), None),
        ("form", "entry: share of the form resembled", (f"{_SEARCH}.candidates:Scorer._resembled_square",), _always(0.0), None),
        ("general", "entry: more general forms", (f"{_SEARCH}.candidates:Scorer._beats_general_forms",), _always(True), None),
        ("distinctive", "entry: distinctive amplitudes", (f"{_SEARCH}.candidates:_has_own_amplitude",), _always(True), None),
        ("pruned", "pruning", (f"{_SEARCH}.search:prune_effects",), _all, None),
        ("predictive", "gain in folds left out", _PREDICTIVE, _all, None),
        ("cancelling", "effects that cancel others", (f"{_SEARCH}.left_out_gain:drop_cancelling",), _all, None),
        ("exchanged", "exchange for likelier rivals", (f"{_SEARCH}.search:exchange_rivals",), _ranked_only, _exchanged),
        ("twins", "twins compared by fit", (f"{_SEARCH}.rivals:_evidence_lead",), lambda _, c, own: c.evidence - own.evidence, None),
        ("outside_values", "values beyond tolerance claimed", (f"{_SEARCH}.search:claim_outside_values",), lambda _, start, current, ranked, *__: (current, ranked), lambda found, start, current, ranked, *_: found[1] is not ranked),
        ("tournament", "tournament of models", (f"{_SEARCH}.search:hold_tournament",), lambda gate, *given: tuple(sorted(gate(*given), key=lambda each: each.name != "effects of the catalogue")), None),
        ("explained", "channels have to be explained", (f"{_DIAGNOSE}:assess_findings",), _keep_found, None),
        ("noise_excess", "noise above the stated one", (f"{_JUDGING}.unexplained:_noise_excess",), _always(1.0), None),
        ("bursts", "bursts above the band", (f"{_DIAGNOSE}:find_bursts",), _always(None), None),
        ("significance", "2 deviations from zero, all counted", (f"{_DIAGNOSE}:drop_insignificant",), _keep_all, _dropped),
        ("band", "deviation: half the band", (f"{_DIAGNOSE}:add_band_deviation",), _third, None),
        ("model_residual", "deviation: open residual of a model", (f"{_DIAGNOSE}:add_left_open_deviation",), _third, None),
        ("scale", "deviation: torque constant", (f"{_DIAGNOSE}:add_scale_deviation",), lambda _, estimate, selected: estimate, None),
        ("left_open", "odds: laws left open", (f"{_CONCLUSIONS}:left_out_gains",), _gains_with(left_open=0.0), None),
        ("spread", "odds: spread of the gain", (f"{_CONCLUSIONS}:left_out_gains",), _gains_with(support=1.0), None),
        ("null", "odds: p-value", (f"{_CONCLUSIONS}:_null_share",), _always(0.0), None),
        ("ensemble", "odds: perturbation ensemble", (f"{_DIAGNOSE}:recurrence",), lambda _, comparison, selected, *__, **___: (np.ones(len(selected)), tuple(selected)), None),
        ("quasi_static", "quasi-static retry", (f"{_TRAINING}:TrainingSearch._retry_quasi_static",), lambda _, searches, training, result: (training, result), None),
        ("contacts", "contact intervals excluded", (f"{_TRAINING}:TrainingSearch._exclude_contacts",), lambda _, searches, training, result: (training, result, ()), None),
    )
)  # fmt: skip


def _patch(stack: ExitStack, place: str, wrap: Callable[[Any], Callable[..., Any]]) -> None:
    module, _, name = place.partition(":")
    owner: Any = importlib.import_module(module)
    *parents, last = name.split(".")
    for each in parents:
        owner = getattr(owner, each)
    stack.enter_context(mock.patch.object(owner, last, wrap(getattr(owner, last))))


@contextmanager
def without_gate(gate: Gate) -> Iterator[None]:
    """Take a gate out."""

    def wrap(original: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(original)
        def replaced(*given: Any, **named: Any) -> Any:
            return gate.without(original, *given, **named)

        return replaced

    with ExitStack() as stack:
        for place in gate.places:
            _patch(stack, place, wrap)
        yield


@contextmanager
def noticing(gates: Sequence[Gate]) -> Iterator[set[str]]:
    """Yield the names of the gates that have acted, in the whole tool."""
    acted: set[str] = set()

    def watch(gate: Gate) -> Callable[[Any], Callable[..., Any]]:
        def wrap(original: Callable[..., Any]) -> Callable[..., Any]:
            @functools.wraps(original)
            def watched(*given: Any, **named: Any) -> Any:
                found = original(*given, **named)
                if gate.name not in acted:
                    if gate.acts is not None:
                        differs = gate.acts(found, *given, **named)
                    else:
                        plain = gate.without(lambda *_, **__: found, *given, **named)
                        # Entry tests with other thresholds have to be asked again.
                        if gate.places == _PASSES:
                            plain = gate.without(original, *given, **named)
                        differs = _differs(found, plain)
                    if differs:
                        acted.add(gate.name)
                return found

            return watched

        return wrap

    with ExitStack() as stack:
        for gate in gates:
            for place in gate.places:
                _patch(stack, place, watch(gate))
        yield acted
