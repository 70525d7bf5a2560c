#!/usr/bin/env bash
# Sets everything up and runs every check: style, types, import order, tests, conformance.
#
#   ./test.sh              everything but the tests marked nightly
#   ./test.sh --changed    style, types and import order, and the tests responsible for the differences from main
#   ./test.sh --nightly    the tests marked nightly, too (proofs of the tests themselves, thousands of random programs),
#                          and property tests with new examples, 20 times as many
#   ./test.sh --nightly --shard K/N --minutes M
#                          only the nightly tests, of those the K-th of N parts, within M minutes, each option by choice;
#                          tests/nights.tsv then says when each test last passed (tests/kits/nights.py)
#   ./test.sh -k name …    only tests, with these options of pytest
set -euo pipefail
cd "$(dirname "$0")"
case "${1:-}" in
-h | --help)
    sed -n '2,11s/^# \{0,1\}//p' "$0"
    exit 0
    ;;
esac
export PIP_COMPILE=0  # not the bytecode of 90 packages: that of what the tests import is written when they do
# shellcheck source=scripts/setup.sh
. scripts/setup.sh
setup dev libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri pocl-opencl-icd libfribidi0 mesa-vulkan-drivers xvfb xdotool
unset PYTHONDONTWRITEBYTECODE  # the tests start hundreds of processes, which share the bytecode
cores=$(nproc)
workers=$((cores > 2 ? cores : 2))
options=()
if [ "${1:-}" = --nightly ]; then
    shift
    case "${1:-}" in
    --shard* | --minutes*) exec .venv/bin/python tests/kits/nights.py run --processes "$workers" "$@" ;;
    esac
    options=(-m "" --hypothesis-profile nightly)
else
    export RHI_KERNELS="${RHI_KERNELS:-quick}"  # optimised kernels, which compute the same bits, in the tests about them
fi
changed=()
if [ "${1:-}" = --changed ]; then
    mapfile -t changed < <(.venv/bin/python tests/meta/responsible_tests.py)
elif [ $# -gt 0 ]; then
    exec .venv/bin/python -m pytest "${options[@]}" "$@"
fi
echo "[test] ruff"
.venv/bin/ruff check .
.venv/bin/ruff format --check .
echo "[test] clang-format"
find rhi -name '*.cl' -print0 | xargs -0 .venv/bin/clang-format --dry-run -Werror
echo "[test] mypy --strict"
.venv/bin/python scripts/check_types.py -n "$workers"
echo "[test] import order"
.venv/bin/lint-imports --no-cache
if [ ${#changed[@]} -gt 0 ]; then
    echo "[test] pytest: ${changed[*]}"
    exec .venv/bin/python -m pytest --file-processes "$workers" "${changed[@]}"
fi
# Workers that had run thousands of tests have ended there without a word; a process of its own never has.
apart=tests/rhi/backends/cl/test_cl_builds.py
echo "[test] pytest: kernels that other processes optimise"
.venv/bin/python -m pytest --capture=sys "${options[@]}" "$apart"
echo "[test] pytest: tests, and the conformance kit on gl, cl and null, on all cores"
# A group of files has a process, which builds their programs once (tests/kits/file_processes.py).
all=(tests --ignore "$apart" --pyargs rhi.conformance --rhi-backend gl --rhi-backend cl --rhi-backend null)
run=(--file-processes "$workers" --durations 15)
exec .venv/bin/python -m pytest "${run[@]}" "${options[@]}" "${all[@]}"
