"""A function of SX as values that are computed one after another, none of them twice."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import casadi as ca

# Reads that do not matter to a value: those of another order are the same value.
_COMMUTE = (ca.OP_ADD, ca.OP_MUL)
# What computes nothing.
GIVEN = (ca.OP_INPUT, ca.OP_CONST)


@dataclass(frozen=True)
class Operations:
    """What a function computes.

    Parameters
    ----------
    function : casadi.Function
    values : list of (operation, what)
        What each value is: its CasADi operation and the numbers of the values that it reads, or of
        `OP_INPUT` (input, place), or of `OP_CONST` (number,).
    results : list of (output, place, value)
    """

    function: ca.Function
    values: list[tuple[int, tuple[Any, ...]]]
    results: list[tuple[int, int, int]]

    def is_computed(self, value: int) -> bool:
        """Whether a value is neither an input nor a constant."""
        return self.values[value][0] not in GIVEN

    @functools.cached_property
    def reads(self) -> list[tuple[int, ...]]:
        """Values that each value is computed from."""
        return [() if operation in GIVEN else what for operation, what in self.values]

    def uses(self) -> list[int]:
        """How often each value is read, as a result or by another value."""
        found = [0] * len(self.values)
        for read in self.reads:
            for value in read:
                found[value] += 1
        for _, _, value in self.results:
            found[value] += 1
        return found


def operations_of(function: ca.Function) -> Operations:
    """Read what a function of SX computes."""
    numbers: dict[tuple[int, tuple[Any, ...]], int] = {}
    results: list[tuple[int, int, int]] = []
    held: dict[int, int] = {}  # value in each place of CasADi's work vector
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        read, written = function.instruction_input(k), function.instruction_output(k)
        what: tuple[Any, ...]
        if operation == ca.OP_OUTPUT:
            out, place = written
            results.append((out, place, held[read[0]]))
            continue
        if operation == ca.OP_INPUT:
            what = tuple(read)
        elif operation == ca.OP_CONST:
            # As text, by which numbers that are none are equal and zeros of two signs are not.
            what = (float(function.instruction_constant(k)).hex(),)
        elif len(read) == 1:
            what = (held[read[0]],)
        else:
            first, last = held[read[0]], held[read[1]]
            swapped = first > last and operation in _COMMUTE
            what = (last, first) if swapped else (first, last)
        held[written[0]] = numbers.setdefault((operation, what), len(numbers))
    return Operations(function, list(numbers), results)
