#!/usr/bin/env bash
# Builds the source distribution, installs it into an empty virtual environment outside of the checkout, and runs a
# smoke test there. Usage: tools/packaging.sh <folder with maturin and python>
set -euo pipefail
bin=$(cd "$1" && pwd)
root=$(cd "$(dirname "$0")/.." && pwd)
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
# What comes from the registry need not be compiled twice: the tests of the Python module have compiled it with this profile.
export CARGO_TARGET_DIR="$root/target"
export MATURIN_PEP517_ARGS="--profile dev"
# What the project itself has is compiled once more, for it lies elsewhere: quickly, for it runs once.
export CARGO_PROFILE_DEV_OPT_LEVEL=0
"$bin/maturin" sdist --manifest-path "$root/crates/pydfo/Cargo.toml" --out "$out/dist" >/dev/null 2>"$out/log" || { cat "$out/log"; exit 1; }
"$bin/python" -m venv "$out/venv"
cd "$out"
"$out/venv/bin/python" -m pip install --quiet --disable-pip-version-check "$out"/dist/*.tar.gz
"$out/venv/bin/python" "$root/crates/pydfo/tests/smoke.py"
