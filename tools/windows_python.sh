#!/usr/bin/env bash
# Runs the tests of the Python module in a Python for Windows, under Wine: windows_python.sh WINE PYTHON_EXE BIN [PYTEST ARGUMENTS]
# BIN has maturin and a Python of this system. WINEPREFIX is a folder that `wine_prefix.sh` has made. The Python for Windows
# has NumPy and pytest; Wine 8.0 lacks functions that NumPy 2 needs.
set -euo pipefail
wine=$1 python=$2 bin=$3
shift 3
site=target/windows-python
rm -rf "$site"
"$bin/maturin" build --quiet --profile quick --target x86_64-pc-windows-gnu --manifest-path crates/pydfo/Cargo.toml --out "$site/wheels" -i python3.11
"$bin/python" -m zipfile -e "$site"/wheels/*.whl "$site/site"
export PYTHONPATH="Z:${PWD//\//\\}\\${site//\//\\}\\site" MPLBACKEND=Agg
# Python for Windows needs pipes, or a terminal of Wine, as its standard input and output.
sleep 1 | "$bin/python" tools/wine_cc.py "$wine" "$python" -m pytest -q -p no:cacheprovider -o faulthandler_timeout=120 \
	--rootdir=crates/pydfo -c crates/pydfo/pyproject.toml "${@:-crates/pydfo/tests}" 2>&1 | cat
