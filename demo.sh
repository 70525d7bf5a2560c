#!/usr/bin/env bash
# Sets everything up, renders the city to out/city.png, and prints the cost of each run.
#
#   ./demo.sh [SCENE]      a scene spec such as city:blocks=20, hall, or a model file
set -euo pipefail
cd "$(dirname "$0")"
case "${1:-}" in
-h | --help)
    sed -n '2,4s/^# \{0,1\}//p' "$0"
    exit 0
    ;;
esac
# shellcheck source=scripts/setup.sh
. scripts/setup.sh
setup renderer libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri pocl-opencl-icd libfribidi0
export RHI_KERNELS="${RHI_KERNELS:-optimised}"  # what is compared is the speed of a long run
exec .venv/bin/python -m renderer demo "${1:-city}" --output out
