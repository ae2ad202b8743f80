"""A job's file at the shop: whole with the files that it names, wherever they lay."""

from __future__ import annotations

from pathlib import Path

import pytest

from polishd.config.job_file import JobFile
from polishd.model.errors import ConfigError
from polishd.shop import parts
from polishd.shop.parts import digests, part_of, read_part

JOB = """\
# the customer's lens
[job]
id = "lens"

[part]
id = "P-1"
form = "maps/nominal.dat"   # of the drawing

[program]
path = "a/lens.rnc"
dialects = ["b/lens.rnc", "a/lens.rnc"]
"""


def write(folder: Path) -> Path:
    for name, content in (("maps/nominal.dat", b"n"), ("a/lens.rnc", b"one"), ("b/lens.rnc", b"two")):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    (folder / "lens.toml").write_text(JOB)
    return folder / "lens.toml"


def test_its_files_come_along_by_names_without_folders_and_its_words_stay(tmp_path: Path) -> None:
    part = read_part(write(tmp_path))
    assert (part.job, part.part_id) == ("lens", "P-1")
    assert sorted(part.files.values()) == [b"n", b"one", b"two"]
    assert not any("/" in name for name in part.files)
    assert "# the customer's lens" in part.content
    there = tmp_path / "elsewhere"
    there.mkdir()
    for name, content in part.files.items():
        (there / name).write_bytes(content)
    file = JobFile(there / "job.toml", part.content)
    named = dict(file.named(file.fragment()[0]))
    assert Path(named["program.path"]).read_bytes() == b"one"
    assert [Path(one).read_bytes() for one in named["program.dialects"]] == [b"two", b"one"]
    assert set(digests(part)) == set(part.files)
    assert part_of(part.content, part.files) == part


def test_a_file_that_is_missing_too_large_or_no_job_is_refused_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path)
    (tmp_path / "maps" / "nominal.dat").unlink()
    with pytest.raises(ConfigError, match=r"part\.form: .*nominal\.dat: cannot be read"):
        read_part(path)
    write(tmp_path)
    monkeypatch.setattr(parts, "MOST_BYTES", 3)
    with pytest.raises(ConfigError, match="its files are more than"):
        read_part(path)
    path.write_text('[cell]\nname = "x"\n')
    with pytest.raises(ConfigError, match=r"(?s)belongs into the cell's file.*job\.id: is missing"):
        read_part(path)
