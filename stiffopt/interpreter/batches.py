"""Instructions in batches of one kind each, and the places that their values have.

A batch is one loop of the processor: which kind comes next is asked once a batch, not once an
instruction.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence

from .instructions import Instruction


def batches(instructions: Sequence[Instruction]) -> list[list[Instruction]]:
    """The same instructions in another order: batches of one kind, each as long as can be.

    Parameters
    ----------
    instructions : sequence of Instruction
        Each behind those whose values it reads.
    """
    computed = {each.value for each in instructions}
    readers: dict[int, list[Instruction]] = defaultdict(list)
    missing: dict[int, int] = {}
    ready: dict[str, list[Instruction]] = defaultdict(list)
    for each in instructions:
        needed = [value for value in each.read if value in computed]
        missing[each.value] = len(needed)
        for value in needed:
            readers[value].append(each)
        if not needed:
            ready[each.kind].append(each)
    found: list[list[Instruction]] = []
    while ready:
        kind = max(ready, key=lambda kind: len(ready[kind]))
        batch = ready.pop(kind)
        for each in batch:
            for reader in readers[each.value]:
                missing[reader.value] -= 1
                if not missing[reader.value]:
                    # Those that can follow in this batch do.
                    (batch if reader.kind == kind else ready[reader.kind]).append(reader)
        found.append(batch)
    return found


def places(
    given: Iterable[int], listed: Sequence[Sequence[Instruction]], results: Iterable[int]
) -> tuple[dict[int, int], int]:
    """Places of values in the work vector, as few as there are values at a time.

    Parameters
    ----------
    given : iterable of int
        Values that are there before the first batch.
    listed : sequence of sequence of Instruction
    results : iterable of int
        Values that must be there behind the last batch.

    Returns
    -------
    dict, int
        Place of every value, and how many there are.
    """
    order = [each for batch in listed for each in batch]
    last = {value: k for k, each in enumerate(order) for value in (*each.read, each.value)}
    last |= dict.fromkeys(results, len(order))
    ending: dict[int, list[int]] = defaultdict(list)
    for value, k in last.items():
        ending[k].append(value)
    found = {value: place for place, value in enumerate(given)}
    count, free = len(found), list[int]()
    for k, each in enumerate(order):
        # A value may take the place of one that it is computed from: lanes are read before.
        free += [found[value] for value in ending[k] if value != each.value]
        if free:
            found[each.value] = free.pop()
        else:
            found[each.value] = count
            count += 1
        if last[each.value] == k:
            free.append(found[each.value])
    return found, count
