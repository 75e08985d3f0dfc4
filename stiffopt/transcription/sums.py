"""Instructions of a function: its operations, with sums of products taken as one each.

Two thirds of a stage's second derivatives are products that one sum reads and nothing else; they
need neither an instruction nor a place of their own. Every sum is added in the order of the
operations, so its digits are the same.
"""

from __future__ import annotations

import functools
import itertools
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

import casadi as ca

from stiffopt.transcription.operations import GIVEN, Operations

# Terms of a sum that is one instruction, and how many kinds of sums there are, beside those of two
# terms: the most frequent. Each is a loop for the compiler.
_MOST_TERMS = 6
_KINDS = 12

_SUMS = (ca.OP_ADD, ca.OP_SUB)


class Instruction(NamedTuple):
    """How a value is computed.

    Parameters
    ----------
    value : int
    kind : str
        C expression of what is read: x0, x1, ..; or the name of a function of that.
    read : tuple of int
        Values.
    """

    value: int
    kind: str
    read: tuple[int, ...]


class _Term(NamedTuple):
    """A value, or a product of two, that a sum adds or subtracts; and the sum as far as there."""

    sign: str
    read: tuple[int, ...]
    total: int


def instructions(operations: Operations, kinds: dict[int, str]) -> list[Instruction]:
    """Instructions that compute a function's values, each behind those that it reads.

    Parameters
    ----------
    operations : Operations
    kinds : dict
        `Instruction.kind` of every CasADi operation but sums.
    """
    sums, inside = _sums(operations)
    found = Counter(part.kind for terms in sums.values() for part in _in_parts(terms))
    kept = {kind for kind, _ in found.most_common(_KINDS)}
    listed: list[Instruction] = []
    for value, (operation, read) in enumerate(operations.values):
        if value in sums:
            listed += _in_parts(sums[value], kept)
        elif operation not in GIVEN and value not in inside:
            listed.append(Instruction(value, kinds[operation], read))
    return listed


def _sums(operations: Operations) -> tuple[dict[int, list[_Term]], set[int]]:
    """Terms of every sum, by its value, and the values that are nothing but a part of one."""
    uses, reads = operations.uses(), operations.reads
    sums, inside = dict[int, list[_Term]](), set[int]()
    kind = [operation for operation, _ in operations.values]
    # How well a sum goes on with a value: with another sum, else with a product.
    rank = [
        (2 * (kind[value] in _SUMS) + (kind[value] == ca.OP_MUL)) * (uses[value] == 1)
        for value in range(len(kind))
    ]

    def factors(value: int) -> tuple[int, ...]:
        if rank[value] != 1:
            return (value,)
        inside.add(value)
        return reads[value]

    for value in reversed(range(len(kind))):
        if value in inside or kind[value] not in _SUMS:
            continue
        terms: list[_Term] = []
        total = value
        while True:
            first, last = reads[total]
            adds = kind[total] == ca.OP_ADD
            if adds and rank[last] > rank[first]:
                first, last = last, first
            terms.append(_Term("+" if adds else "-", factors(last), total))
            if rank[first] < 2:
                break
            inside.add(first)
            total = first
        terms.append(_Term("", factors(first), first))
        sums[value] = terms[::-1]
    return sums, inside


def _in_parts(terms: list[_Term], kept: set[str] | None = None) -> Iterator[Instruction]:
    """A sum by instructions of the kinds that are kept, each going on from the one before."""
    while len(terms) > 1:
        for count in range(min(len(terms), _MOST_TERMS), 1, -1):
            part = terms[:count]
            kind = _expression(tuple((term.sign, len(term.read)) for term in part))
            if count == 2 or kept is None or kind in kept:
                break
        total = part[-1].total
        yield Instruction(total, kind, tuple(each for term in part for each in term.read))
        terms = [_Term("", (total,), total), *terms[count:]]


@functools.cache
def _expression(form: tuple[tuple[str, int], ...]) -> str:
    """C expression of terms, each a sign and the number of its factors."""
    read = itertools.count()
    return "".join(
        sign + "*".join(f"x{next(read)}" for _ in range(factors)) for sign, factors in form
    )
