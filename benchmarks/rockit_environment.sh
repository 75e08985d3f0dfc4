#!/bin/sh
# Environment of the peer rockit, apart from that of stiffopt: benchmarks/.rockit-venv.
# Usage: sh benchmarks/rockit_environment.sh    (PYTHON names another interpreter)
set -eu
here=$(cd "$(dirname "$0")" && pwd)
venv="$here/.rockit-venv"
"${PYTHON:-python3}" -m venv "$venv"
# CasADi and NumPy as stiffopt uses them, so that the comparison is one of transcriptions.
"$venv/bin/python" -m pip install --quiet \
    "rockit-meco==0.6.7" "casadi==3.8.2" "numpy>=2.2,<2.5" scipy matplotlib
"$venv/bin/python" -c "import rockit, casadi; print('rockit-meco 0.6.7, casadi', casadi.__version__)"
