#!/usr/bin/env bash
# Sets everything up and runs every check: style, types, import order, tests, conformance.
#
#   ./test.sh              all of it
#   ./test.sh -k name …    only tests, with these options of pytest
set -euo pipefail
cd "$(dirname "$0")"
case "${1:-}" in
-h | --help)
    sed -n '2,5s/^# \{0,1\}//p' "$0"
    exit 0
    ;;
esac
# shellcheck source=scripts/setup.sh
. scripts/setup.sh
setup dev libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri pocl-opencl-icd
if [ $# -gt 0 ]; then
    exec .venv/bin/python -m pytest "$@"
fi
echo "[test] ruff"
.venv/bin/ruff check .
echo "[test] mypy --strict"
.venv/bin/mypy
echo "[test] import order"
.venv/bin/lint-imports --no-cache
echo "[test] pytest: tests, and the conformance kit on gl, cl and null, on all cores"
exec .venv/bin/python -m pytest -n auto --dist worksteal tests --pyargs rhi.conformance --rhi-backend gl --rhi-backend cl --rhi-backend null
