"""Run all benchmarks and write their tables to RESULTS.md beside this file.

    python benchmarks/run.py [NAME ...]

With names (fixed_path, model_cost, ...) only those run, and only print. Peers are
compared by `python -m benchmarks.peers`. The computer should have nothing else to do.
"""

from __future__ import annotations

import sys
from importlib import import_module

from common import HERE, require_data, table

from stiffopt.result.provenance import versions

BENCHMARKS = (
    "ur10_torque_squared",
    "fixed_path",
    "dynamic_deflection",
    "elastic_simulation",
    "compensation",
    "random_deviation",
    "model_cost",
    "interpreter",
    "scaling",
    "sweeps",
    "second_answers",
)
HEAD = """# Results of one run

Ratios of times hold within one table, the seconds themselves only on the computer of the run.
Reference numbers come from the problem data and from the peers named in each row. "Worst limit
between nodes" is the largest violation on the certificate's grid, negative where there is margin.
How 200 random problems of all objectives ended is counted in RANDOM.md.
"""


def main(names: list[str]) -> None:
    """Run the named benchmarks, or all of them and keep the tables."""
    require_data()
    unknown = sorted(set(names) - set(BENCHMARKS))
    if unknown:
        sys.exit(f"no benchmark {', '.join(unknown)}; allowed: {', '.join(BENCHMARKS)}")
    tables = []
    for name in names or BENCHMARKS:
        module = import_module(name)
        tables.append(table(module.TITLE, module.run()))
        print(tables[-1], flush=True)
        print()
    if not names:
        used = ", ".join(f"{package} {number}" for package, number in versions().items())
        text = "\n\n".join([HEAD + f"\nVersions: {used}.", *tables])
        (HERE / "RESULTS.md").write_text(text + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
