"""What is spoiled, and what then reads it: small sound files of every kind with their loaders."""

from __future__ import annotations

from pathlib import Path

from benchmarks.reliability.answers import answers
from benchmarks.reliability.documents import begun, documents, sets
from benchmarks.reliability.run_files import run_files
from benchmarks.reliability.subject import Subject
from benchmarks.reliability.surroundings import surroundings


def subjects(place: Path, *, with_answers: bool = True) -> list[Subject]:
    """Every kind, laid out below `place`; answers take a solve and a diagnosis to make."""
    files = [
        *documents(place),
        *sets(place),
        *surroundings(place),
        *run_files(place),
        *begun(place),
    ]
    return [*files, *(answers(place) if with_answers else ())]
