"""A function of SX as values that are computed one after another, none of them twice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

# Reads that do not matter to a value: those of another order are the same value.
_COMMUTE = (ca.OP_ADD, ca.OP_MUL)


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
        return self.values[value][0] not in (ca.OP_INPUT, ca.OP_CONST)

    def read_by(self, value: int) -> tuple[int, ...]:
        """Values that a value is computed from."""
        return self.values[value][1] if self.is_computed(value) else ()

    def uses(self) -> list[int]:
        """How often each value is read, as a result or by another value."""
        found = [0] * len(self.values)
        for value in range(len(self.values)):
            for each in self.read_by(value):
                found[each] += 1
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
        if operation == ca.OP_OUTPUT:
            out, place = written
            results.append((out, place, held[read[0]]))
            continue
        what: tuple[Any, ...]
        if operation == ca.OP_INPUT:
            what = tuple(read)
        elif operation == ca.OP_CONST:
            # As text, by which numbers that are none are equal and zeros of two signs are not.
            what = (float(function.instruction_constant(k)).hex(),)
        else:
            what = tuple(held[place] for place in read)
            if operation in _COMMUTE:
                what = tuple(sorted(what))
        held[written[0]] = numbers.setdefault((operation, what), len(numbers))
    return Operations(function, list(numbers), results)
