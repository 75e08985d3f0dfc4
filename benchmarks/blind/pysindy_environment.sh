#!/bin/sh
# An environment for the sparse-regression rival: pysindy has its own versions of things.
set -e
target="${1:-$(dirname "$0")/work/pysindy}"
python3 -m venv "$target"
"$target/bin/pip" install --quiet pysindy==2.1.0
"$target/bin/python" -c "import pysindy; print('pysindy', pysindy.__version__)"
