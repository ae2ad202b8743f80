#!/bin/bash
# The whole move on a fresh clone: prove.sh CLONE OUT. The project's commit that is checked out here is what moves.
set -euo pipefail
here=$(dirname "$(realpath "$0")") root=$(realpath "$(dirname "$(realpath "$0")")/../../..")
clone=$(realpath -m "$1") out=$(realpath -m "$2")
mkdir -p "$out"
[ ! -d "$clone/.venv" ] || mv "$clone/.venv" "$clone.venv" # one of before serves again
rm -rf "$clone" && git clone -q "$root" "$clone"
if [ -d "$clone.venv" ]; then mv "$clone.venv" "$clone/.venv"; else cp -a "$root/.venv" "$clone/.venv"; fi
cd "$clone"
grep -rlI "$root" .venv/bin .venv/pyvenv.cfg .venv/lib/python3*/site-packages/*.pth \
    .venv/lib/python3*/site-packages/polishd*.dist-info | xargs -r sed -i "s#$root#$clone#g" || true
"$here/run.sh" "$clone" "$out"
