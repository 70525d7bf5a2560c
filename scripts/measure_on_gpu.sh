#!/usr/bin/env bash
# Measures every figure that the docs have of a GPU (docs/measurements/performance.md, "On a GPU"), in at most
# eight minutes: draw costs, frames by technique, two eyes, the main thread's time, and the conformance kit.
#
#   scripts/measure_on_gpu.sh [--small] [FOLDER]
#
# Each part is a file in FOLDER (default: out/gpu). A part that fails or takes too long doesn't end the others; then
# the exit status is 1. --small measures small images of small scenes once, which shows on any machine that all
# parts run. PYTHON is the interpreter (default: .venv/bin/python, else python).
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

deadline=$((SECONDS + 480))
size=1920x1080 rounds=5 frames=10 draws=2000 batch=200
city=city nights="night:lights=64 night:lights=1024 night:lights=4096" hall=hall:lights=1024
techniques=() kit=() small=
if [ "${1:-}" = --small ]; then
    shift
    small=yes
    size=64x36 rounds=1 frames=1 draws=50 batch=5
    city=city:blocks=2,detail=2 nights=night:blocks=2,lights=8 hall=hall:columns=4,lights=8
    techniques=(--techniques forward,clustered) kit=(-k "clear and color")
fi
folder=${1:-out/gpu}
python=${PYTHON:-.venv/bin/python}
[ -x "$python" ] || python=python
mkdir -p "$folder"
failed=0

# part NAME SECONDS COMMAND…: write what a command prints to a file, and stop it after so many seconds.
part() {
    local name=$1 seconds=$2 began=$SECONDS status=0
    shift 2
    local left=$((deadline - SECONDS))
    if [ -n "$small" ] || [ "$left" -lt "$seconds" ]; then # a processor is slow, whatever the size
        seconds=$left
    fi
    if [ "$seconds" -lt 5 ]; then
        echo "$name: no time left"
        failed=1
        return
    fi
    { echo "\$ $*" && timeout "$seconds" "$@"; } >"$folder/$name.txt" 2>"$folder/$name.log" || status=$?
    if [ "$status" -eq 0 ]; then
        echo "$name: $((SECONDS - began)) s"
    else
        echo "$name: status $status after $((SECONDS - began)) s; see $folder/$name.log"
        failed=1
    fi
}

part machine 30 "$python" -m rhi
part draw-cost 45 "$python" benchmarks/draw_cost.py --draws "$draws" --rounds "$((4 * rounds + 1))" --markdown
for scene in "$city" $nights; do
    part "techniques-${scene//[:,=]/-}" 70 "$python" -m renderer compare techniques "$scene" --backend gl \
        --camera ground --frame 705 --size "$size" --rounds "$rounds" "${techniques[@]}" --markdown
done
part "techniques-${hall//[:,=]/-}" 70 "$python" -m renderer compare techniques "$hall" --backend gl \
    --size "$size" --rounds "$rounds" "${techniques[@]}" --markdown
part stereo 70 "$python" -m renderer compare stereo "$city" --backend gl --sizes "$size" --shadows off,on \
    --frames "$frames" --markdown
for scene in "$city" grid:count=1; do
    part "main-thread-${scene//[:,=]/-}" 30 "$python" benchmarks/frame_batch.py --backend gl --scene "$scene" \
        --rounds "$batch" --markdown
done
for backend in gl wgpu; do
    part "kit-$backend" 90 "$python" -m pytest -q -p no:cacheprovider --pyargs rhi.conformance \
        --rhi-backend "$backend" ${kit[@]+"${kit[@]}"}
done
exit "$failed"
