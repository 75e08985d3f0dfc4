"""What every format of an exported motion must answer, and the registry that holds them."""

from __future__ import annotations

from abc import ABC, abstractmethod

from stiffopt.export.motion import SampledMotion, StoredMotion, check_rate
from stiffopt.export.seal import seal_entries, with_seal
from stiffopt.problem.registry import Registry


class ExportFormat(ABC):
    """A way to hand a motion to others.

    Attributes
    ----------
    name : str
        Of `--to`.
    title : str
        What reads it.
    rate : float
        Where none is given [Hz].
    rate_max : float
        The most that it takes [Hz].
    whole_steps : bool
        Whether it has a fixed cycle: every step is then 1/rate.
    from_rest : bool
        Whether its programs move to the start and stop at the end, so that the motion must begin
        and end at rest.
    """

    name: str
    title: str
    rate: float
    rate_max: float
    whole_steps = False
    from_rest = False

    def export(self, stored: StoredMotion, rate: float | None = None) -> dict[str, str]:
        """Texts of the files by their name.

        Parameters
        ----------
        stored : StoredMotion
        rate : float, optional [Hz]

        Raises
        ------
        InputError
            The rate, the joints or their positions are beyond what the format takes, or the samples
            exceed a limit.
        """
        chosen = self.rate if rate is None else rate
        check_rate(chosen, self.rate_max, self.title)
        self.check(stored, chosen)
        if self.from_rest:
            stored.require_rest(self.title)
        motion = stored.sampled(chosen, whole_steps=self.whole_steps)
        stored.judge(motion)
        texts = {
            name: with_seal(text, seal_entries(stored, self.name, chosen, name), name)
            for name, text in self.files(motion, chosen).items()
        }
        return texts | self.programs(texts)

    def check(self, stored: StoredMotion, rate: float) -> None:  # noqa: B027
        """Raise `InputError` for what the format cannot hold; default: it holds all."""

    @abstractmethod
    def files(self, motion: SampledMotion, rate: float) -> dict[str, str]:
        """Texts of the files by their name, of a motion sampled at `rate` [Hz]."""

    def programs(self, texts: dict[str, str]) -> dict[str, str]:
        """Texts of programs that send the files, by name; default: none."""
        return {}


FORMATS: Registry[ExportFormat] = Registry("stiffopt.export.formats")
