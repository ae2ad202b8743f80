"""Arrays beside the journal: content with the named hash, or an error."""

from __future__ import annotations

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
