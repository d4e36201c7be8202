#!/bin/sh
# Fuzz every target for N seconds of computing, one after another, at the lowest priority, from a copy of the last
# commit (others may be editing the checkout). What the log has already is not done again, so it may be ended and
# started at any time:  setsid nohup sh tests/fuzz/background.sh [N] > out/fuzz/background.txt 2>&1 &
# While /tmp/fuzz.pause exists the fuzzer is stopped.  kill $(cat out/fuzz/background.pid)  ends it.
set -u
child=""
seconds=${1:-600}
root=$(cd "$(dirname "$0")/../.." && pwd)
out=$root/out/fuzz
copy=$out/copy
mkdir -p "$out"
echo $$ > "$out/background.pid"
trap 'kill "$child" 2>/dev/null; exit 143' TERM INT
targets() { cd "$copy" && nice -n 19 "$root/.venv/bin/python" -m tests.fuzz --list; }
fuzz() {
    rm -rf "$copy" && mkdir -p "$copy"
    git -C "$root" archive HEAD | tar -x -C "$copy"
    git -C "$root" rev-parse --short HEAD > "$copy/FUZZED_COMMIT"
    cd "$copy" || exit 1
    nice -n 19 "$root/.venv/bin/python" -m tests.fuzz "$@" --seconds "$seconds" --fill --out "$out" \
        --log "$root/reports/fuzz/runs.jsonl" --pause /tmp/fuzz.pause &
    child=$!
    wait "$child"
}
# first those that had least before, and new ones; then the rest; again, for what a fix or a crash left short
first="run image colmap spec trajectory pickle nerfstudio ply archive chat niqe weights options"
for target in $first; do fuzz "$target"; done
for target in $(targets); do fuzz "$target"; done
for target in $(targets); do fuzz "$target"; done
echo done
