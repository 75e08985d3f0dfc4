"""The least that a run of a few cases has to show, for a test of every commit."""

from __future__ import annotations

from collections.abc import Sequence

from .score import CaseScore
from .tally import of_kind
from .wilson import Rate

# Of single effects at severity 1 and above, effect and joint first; a few cases fall short of it
# only where their interval lies below it.
RIGHT = 0.85
FALSE_ALARMS = 0


def unmet(scores: Sequence[CaseScore]) -> list[str]:
    """What is not as it has to be, a sentence each."""
    found = [f"{s.id}: no answer ({s.status})" for s in scores if s.status != "ok"]
    found += [f"{s.id}: the truth is not the one committed to" for s in scores if not s.sealed]
    single, none = of_kind(scores, "single", 1.0), of_kind(scores, "none")
    if not single or not none:
        found.append("there are no cases to judge by: with one effect, and with nothing missing")
    right = sum(bool(s.exact) for s in single)
    if single and Rate(right, len(single)).interval[1] < RIGHT:
        found.append(f"effect and joint right first in {right} of {len(single)} cases")
    alarms = [s.id for s in none if s.false_alarm]
    if len(alarms) > FALSE_ALARMS:
        found.append(f"false alarms where nothing is missing: {', '.join(alarms)}")
    return found
