"""What results offer in Python and notebooks: one line, a small table, a data frame, a figure."""

from __future__ import annotations

from html import escape
from importlib import import_module
from typing import Any

from stiffopt.errors import InputError


class DisplayedResult:
    """A result that shows itself shortly; subclasses say their facts and their table."""

    def facts(self) -> dict[str, str]:
        """What matters, by name, as texts; the first is the heading."""
        raise NotImplementedError

    def table(self) -> dict[str, Any]:
        """Columns of the data frame, each of the same length."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {', '.join(self.facts().values())}>"

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><th style='text-align:left'>{escape(name)}</th>"
            f"<td style='text-align:left'>{escape(value)}</td></tr>"
            for name, value in self.facts().items()
        )
        return f"<table>{rows}</table>"

    def to_dataframe(self) -> Any:
        """The result's table as a pandas.DataFrame, SI.

        Raises
        ------
        InputError
            pandas is not installed.
        """
        try:
            pandas = import_module("pandas")
        except ModuleNotFoundError as error:
            raise InputError(
                "to_dataframe needs pandas. Install it: pip install 'stiffopt[notebook]'"
            ) from error
        return pandas.DataFrame(self.table())

    def plot(self) -> Any:
        """Figure of the result, a matplotlib.figure.Figure; notebooks show it."""
        # Figures are drawn in `report`, which knows results and is not known to them.
        return import_module("stiffopt.report.notebook").figure_of(self)
