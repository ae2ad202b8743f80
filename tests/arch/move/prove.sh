#!/bin/bash
# The whole move on a fresh clone: prove.sh [CLONE [OUT]]. The project's commit that is checked out here is what moves.
set -euo pipefail
here=$(dirname "$(realpath "$0")") root=$(realpath "$(dirname "$(realpath "$0")")/../../..")
clone=${1:-/work/house2} out=${2:-/tmp/house/out}
rm -rf "$clone" "$out" && mkdir -p "$out"
git clone -q "$root" "$clone"
cp -a "$root/.venv" "$clone/.venv"
cd "$clone"
grep -rlI "$root" .venv/bin .venv/pyvenv.cfg .venv/lib/python3*/site-packages/*.pth \
    .venv/lib/python3*/site-packages/polishd*.dist-info | xargs sed -i "s#$root#$clone#g"
"$here/run.sh" "$clone" "$out"
