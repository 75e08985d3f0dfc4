"""Instructions of a function: its operations, with sums of products taken as one each.

Two thirds of a stage's second derivatives are products that one sum reads and nothing else; they
need neither an instruction nor a place of their own. Every sum is added in the order of the
operations, so its digits are the same.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Container, Iterator
from typing import NamedTuple

import casadi as ca

from .operations import GIVEN, Operations

# Terms of a sum that is one instruction, at most.
MAX_TERMS = 6

_SUMS = (ca.OP_ADD, ca.OP_SUB)


class Instruction(NamedTuple):
    """How a value is computed.

    Parameters
    ----------
    value : int
    kind : str
        Name of a CasADi operation without OP_, or a sum of x0, x1, .., the values read.
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


def instructions(operations: Operations, kinds: Container[str]) -> list[Instruction]:
    """Instructions that compute a function's values, each behind those that it reads.

    Parameters
    ----------
    operations : Operations
    kinds : container of str
        What instructions there are: all operations but sums, all sums of two terms, some longer.
    """
    sums, inside = _sums(operations)
    names = _operation_names()
    listed: list[Instruction] = []
    for value, (operation, read) in enumerate(operations.values):
        if value in sums:
            listed += _in_parts(sums[value], kinds)
        elif operation not in GIVEN and value not in inside:
            listed.append(Instruction(value, names[operation], read))
    return listed


@functools.cache
def _operation_names() -> dict[int, str]:
    """Names of CasADi's operations by their numbers."""
    return {getattr(ca, name): name[3:] for name in dir(ca) if name.startswith("OP_")}


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


def _in_parts(terms: list[_Term], kinds: Container[str]) -> Iterator[Instruction]:
    """Split a sum into instructions of the given kinds, each going on from the one before."""
    while len(terms) > 1:
        for count in range(min(len(terms), MAX_TERMS), 1, -1):
            part = terms[:count]
            kind = _expression(tuple((term.sign, len(term.read)) for term in part))
            if count == 2 or kind in kinds:
                break
        total = part[-1].total
        yield Instruction(total, kind, tuple(each for term in part for each in term.read))
        terms = [_Term("", (total,), total), *terms[count:]]


@functools.cache
def _expression(form: tuple[tuple[str, int], ...]) -> str:
    """Name of a sum of terms, each a sign and the number of its factors."""
    read = itertools.count()
    return "".join(
        sign + "*".join(f"x{next(read)}" for _ in range(factors)) for sign, factors in form
    )
