"""Arrays beside the journal, in a separate folder: content with the named hash, or an error."""

from __future__ import annotations

import hashlib
import io
from pathlib import Path

import numpy as np
import pytest

from polishd.daemon.journal.store import ArrayStore
from polishd.model.errors import ConfigError, SafetyStop


@pytest.fixture
def store(tmp_path: Path) -> ArrayStore:
    return ArrayStore(tmp_path / "state" / "store")


def test_what_is_kept_comes_back(store: ArrayStore) -> None:
    name = store.put({"height_nm": np.array([[1.5, np.nan]]), "mask": np.array([True, False]), "pitch_mm": 0.5})
    back = store.get(name)
    assert np.array_equal(back["height_nm"], [[1.5, np.nan]], equal_nan=True)
    assert back["mask"].dtype == np.bool_
    assert float(back["pitch_mm"]) == 0.5
    assert [path.name for path in store.folder.iterdir()] == [f"{name}.npz"], "whole, and nothing beside it"


def test_the_same_content_is_kept_once(store: ArrayStore) -> None:
    assert store.put({"a": np.arange(9)}) == store.put({"a": np.arange(9)})
    assert store.put({"a": np.arange(8)}) != store.put({"a": np.arange(9)})
    assert len(list(store.folder.iterdir())) == 2


@pytest.mark.parametrize("harm", ["deleted", "changed", "cut short"])
def test_what_is_not_what_the_journal_names_is_refused(store: ArrayStore, harm: str) -> None:
    name = store.put({"a": np.arange(9)})
    path = store.folder / f"{name}.npz"
    if harm == "deleted":
        path.unlink()
    else:
        content = path.read_bytes()
        path.write_bytes(
            content[:-1] if harm == "cut short" else content[:40] + bytes([content[40] ^ 1]) + content[41:]
        )
    with pytest.raises(ConfigError, match=r"\.npz: .*(No such file|another hash).*or set a new job.id"):
        store.get(name)


def test_a_disk_that_takes_nothing_stops_the_job(store: ArrayStore, tmp_path: Path) -> None:
    (tmp_path / "state").write_text("a file in its way")
    with pytest.raises(SafetyStop, match=r"store/.*cannot be written: .*Repair the disk"):
        store.put({"a": np.arange(9)})


def test_what_is_removed_is_gone_and_the_rest_stays(store: ArrayStore) -> None:
    store.remove("never-kept", "")
    one, other = store.put({"a": np.arange(9)}), store.put({"a": np.arange(8)})
    store.remove(one, "")
    assert [path.name for path in store.folder.iterdir()] == [f"{other}.npz"]


def test_its_files_are_their_owners_alone_and_named_by_what_they_hold(store: ArrayStore) -> None:
    name = store.put({"a": np.arange(3)})
    (path,) = store.folder.iterdir()
    assert path == store.folder / f"{name}.npz"
    assert path.stat().st_mode & 0o777 == 0o600
    assert hashlib.sha256(path.read_bytes()).hexdigest() == name
    assert store.content(name) == path.read_bytes()


def test_what_is_packed_already_is_kept_as_it_is(store: ArrayStore) -> None:
    content = store.content(store.put({"a": np.arange(3)}))
    other = ArrayStore(store.folder.parent / "other")
    assert other.content(other.put(content)) == content


def test_what_is_no_array_of_numbers_is_never_made_alive(store: ArrayStore) -> None:
    """A pickle can run anything."""
    packed = io.BytesIO()
    np.savez(packed, a=np.array([{"an": "object"}], dtype=object))
    name = store.put(packed.getvalue())
    with pytest.raises(ValueError, match="allow_pickle"):
        store.get(name)


def test_where_it_is_gone_or_another_one_is_said_with_what_to_do(store: ArrayStore) -> None:
    name = store.put({"a": np.arange(3)})
    path = store.folder / f"{name}.npz"
    path.write_bytes(b"another")
    todo = "the job cannot continue without it. Restore the file, or set a new job.id"
    with pytest.raises(ConfigError) as other:
        store.content(name)
    assert str(other.value) == f"{path}: the content has another hash than the journal states; {todo}"
    store.remove(name)
    with pytest.raises(ConfigError) as gone:
        store.content(name)
    assert str(gone.value) == f"{path}: cannot be read: No such file or directory; {todo}"


def test_a_folder_that_cannot_be_made_stops_polishing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(
        SafetyStop, match="cannot be written: Not a directory; the daemon does not polish without a record"
    ):
        ArrayStore(tmp_path / "file" / "store").put({"a": np.arange(3)})
