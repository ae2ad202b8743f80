#!/bin/bash
# Rename, merge and move the sources into the third house: run.sh CLONE OUT
# CLONE: a clean work tree of this project with its .venv; it is rewritten and committed. OUT: a folder for tables.
set -euo pipefail
clone=$(realpath "$1") out=$(realpath "$2")
# The scripts run from a copy: in the tree they would rewrite themselves.
rm -rf "$out/move" && cp -a "$(dirname "$(realpath "$0")")" "$out/move" && cd "$out/move"
ruff=$clone/.venv/bin/ruff
fix() { (cd "$clone" && "$ruff" check . --select F401,I --fix -q; "$ruff" format -q .) || true; }
commit() { (cd "$clone" && git add -A && git commit -qm "$1"); }
if [ -e "$clone/tests/arch/move" ]; then
    git -C "$clone" rm -rq tests/arch/move && rm -rf "$clone/tests/arch/move" && git -C "$clone" commit -qm "Remove the scripts of the move"
fi
python3 replace.py "$clone" before.toml
python3 tables.py "$clone" "$out/table.txt"
python3 rename.py "$clone" "$out/table.txt" | grep -v '^prose' || true
fix; commit "Rename classes and functions by the field's nouns"
python3 rename.py "$clone" collisions.txt | grep -v '^prose' || true
fix; commit "Rename what would collide in merged files"
python3 collide.py "$clone" map.txt
python3 merge.py "$clone" map.txt "$out"
python3 post.py "$clone" "$out"
python3 tests_move.py "$clone" "$out"
python3 inits.py "$clone"
fix
python3 long_lines.py "$clone"
fix
python3 campaigns.py "$clone" "$out"
python3 replace.py "$clone" after.toml
(cd "$clone" && "$ruff" check . --fix -q --output-format concise || true; "$ruff" format -q .)
cd "$clone"
commit "Move and merge the sources into folders by subject"
touch .venv/.locked
.venv/bin/python -m pip -qq --disable-pip-version-check --no-input install --no-deps --no-build-isolation --editable .
touch .venv/.installed
.venv/bin/python -m docs.reference.write && .venv/bin/python -m docs.reference.man
"$ruff" format -q .
git diff --quiet || commit "Write the reference from the moved sources"
