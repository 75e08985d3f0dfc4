"""Environments of their own for what the package is compared with."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Environments:
    """Virtual environments under one folder, each with pinned packages.

    Attributes
    ----------
    folder : Path
    packages : dict of str to tuple of str or None
        By name, what pip installs; None needs only this interpreter.
    """

    folder: Path
    packages: dict[str, tuple[str, ...] | None]

    def install(self, names: list[str]) -> None:
        """Make the named environments, or all; why not stays in a file beside them."""
        for name in names or list(self.packages):
            needed = self.packages[name]
            if needed is None:
                continue
            place, reason = self.folder / name, self._reason(name)
            subprocess.run([sys.executable, "-m", "venv", str(place)], check=True)
            pip = [str(place / "bin" / "pip"), "install", "-q", *needed]
            done = subprocess.run(pip, capture_output=True, text=True, check=False)
            if done.returncode:
                told = [line for line in done.stderr.splitlines() if "ERROR" in line]
                reason.write_text((told or ["pip failed"])[-1].removeprefix("ERROR: "))
            else:
                reason.unlink(missing_ok=True)
            print(f"{name}: {'does not install here' if done.returncode else 'installed'}")

    def python(self, name: str) -> Path | None:
        """The interpreter of an environment; None where it is absent."""
        if self.packages[name] is None:
            return Path(sys.executable)
        found = self.folder / name / "bin" / "python"
        return found if found.is_file() and not self._reason(name).is_file() else None

    def absence(self, name: str) -> str:
        """Why an environment is absent."""
        reason = self._reason(name)
        return reason.read_text().strip() if reason.is_file() else "not installed"

    def _reason(self, name: str) -> Path:
        return self.folder / f"{name}.absent"
