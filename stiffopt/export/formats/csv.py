"""CSV: time, positions, velocities and accelerations under the joints' names."""

from __future__ import annotations

import csv
import io

import numpy as np

from stiffopt.export.format import FORMATS, ExportFormat
from stiffopt.export.motion import SampledMotion


class Csv(ExportFormat):
    """CSV file with one header row, SI numbers with full precision; events if there are any."""

    name = "csv"
    title = "CSV"
    rate = 500.0
    rate_max = 20000.0

    def files(self, motion: SampledMotion, rate: float) -> dict[str, str]:
        """Text of the one file."""
        names = ["time"]
        for suffix in ("", "_velocity", "_acceleration"):
            names += [f"{joint}{suffix}" for joint in motion.joint_names]
        columns = [motion.time[:, None], motion.position, motion.velocity, motion.acceleration]
        rows = np.hstack(columns).tolist()
        if motion.events:
            names.append("event")
            for k, row in enumerate(rows):
                row.append(" ".join(each.kind for each in motion.events_until(k)))
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(names)
        writer.writerows(rows)
        return {f"{motion.which}.csv": text.getvalue()}


FORMATS.add(Csv())
