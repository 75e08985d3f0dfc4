#!/bin/sh
# An environment for the peers of the search for laws: they have their own versions of things.
set -e
target="${1:-$(dirname "$0")/work/law_peers}"
python3 -m venv "$target"
"$target/bin/pip" install --quiet pysindy==2.1.0 gplearn
