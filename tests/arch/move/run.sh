#!/bin/bash
# Rename, merge and move the sources into the third house, in a clone: run.sh CLONE OUT
# CLONE: a git clone of this project with its .venv; its work tree is rewritten and committed. OUT: a folder for tables.
set -euo pipefail
clone=$(realpath "$1") out=$(realpath "$2") here=$(dirname "$(realpath "$0")")
ruff=$clone/.venv/bin/ruff
cd "$here"
python3 tables.py "$clone" "$out/table.txt"
python3 rename.py "$clone" "$out/table.txt" | grep -v '^prose' || true
(cd "$clone" && "$ruff" format -q . && "$ruff" check . --select F401,I --fix -q || true; git commit -qam "Rename classes and functions by the field's nouns")
python3 rename.py "$clone" collisions.txt | grep -v '^prose' || true
(cd "$clone" && "$ruff" format -q . && git commit -qam "Rename what would collide in merged files")
python3 collide.py "$clone" map.txt
python3 merge.py "$clone" map.txt "$out"
python3 post.py "$clone" "$out"
cd "$clone"
"$ruff" format -q . || true
"$ruff" check . --select F,E9,I,E402 --fix -q --output-format concise || true
"$ruff" format -q .
git add -A && git commit -qm "Move and merge the sources into folders by subject"
