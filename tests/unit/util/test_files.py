"""Files are written whole or not at all; secrets in files and in the environment, who may read and inherit them."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import tempfile
import threading
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

from polishd.model.errors import ConfigError
from polishd.util.files import (
    SecretPlace,
    environment_without_secrets,
    make_folder,
    named_path,
    read_all,
    read_input,
    read_secret,
    redact_secrets,
    require_new,
    require_new_file,
    require_private,
    require_writable,
    require_writable_file,
    sync_folder,
    toml_text,
    whole_file,
    write_atomic,
    write_together,
)
from polishd.web.http.users import Role, UserFile


def test_writes_and_replaces(tmp_path: Path) -> None:
    path = tmp_path / "file.bin"
    write_atomic(path, b"old")
    write_atomic(path, b"new \x00 content")
    assert path.read_bytes() == b"new \x00 content"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_takes_files_and_keeps_none(tmp_path: Path) -> None:
    require_writable(tmp_path / "not" / "yet")
    require_writable(tmp_path)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="sub: cannot be written: Not a directory"):
        require_writable(tmp_path / "file" / "sub")


def test_a_full_disk_is_known_beforehand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Full(BytesIO):
        def write(self, content: object) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("polishd.util.files.tempfile.TemporaryFile", lambda **where: Full())
    with pytest.raises(ConfigError, match="cannot be written: No space left on device; make room"):
        require_writable(tmp_path)


def test_mode_is_as_requested(tmp_path: Path) -> None:
    with whole_file(tmp_path / "whole") as file:
        file.write(b"x")
    write_atomic(tmp_path / "open", b"")
    write_atomic(tmp_path / "secret", b"", mode=0o600)
    modes = [(tmp_path / name).stat().st_mode & 0o777 for name in ("whole", "open", "secret")]
    assert modes == [0o644, 0o644, 0o600]


def test_failure_leaves_the_old_file_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file"
    write_atomic(path, b"old")

    def full(handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_atomic(path, b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_the_error_of_a_full_disk_names_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_handle: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")  # as of write(2): without a name

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left") as raised:
        write_atomic(tmp_path / "cell.toml", b"x")
    assert raised.value.filename == str(tmp_path / "cell.toml")


def test_files_written_together_are_all_there_or_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced = []

    def full_at_the_second(handle: int) -> None:
        synced.append(handle)
        if len(synced) == 2:
            raise OSError(errno.ENOSPC, "No space left on device")

    (tmp_path / "b").write_bytes(b"mine")
    with pytest.raises(OSError, match="No such file"):
        write_together(tmp_path, {"a": b"1", "b": b"2", "no/c": b"3"})
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"b": b"mine"}
    monkeypatch.setattr(os, "fsync", full_at_the_second)
    with pytest.raises(OSError, match="No space"):
        write_together(tmp_path, {"a": b"1", "b": b"2"})
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"b": b"mine"}
    write_together(tmp_path, {"a": b"1", "b": b"2"})
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"a": b"1", "b": b"2"}


def test_a_home_folder_that_does_not_exist_is_a_missing_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/homes/me")
    assert named_path(tmp_path, "~/a.toml") == Path("/homes/me/a.toml")
    assert named_path(tmp_path, "a.toml") == tmp_path / "a.toml"
    assert named_path(tmp_path, "~no-such-user/a.toml") == tmp_path / "~no-such-user/a.toml"
    with pytest.raises(ConfigError, match="NUL"):
        named_path(tmp_path, "a\0.toml")


def test_content_is_synced_before_the_rename_and_the_folder_after(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, order = tmp_path / "file", []
    fsync = os.fsync

    def watched(handle: int) -> None:
        order.append(("file" if Path(f"/proc/self/fd/{handle}").is_file() else "folder", path.exists()))
        fsync(handle)

    monkeypatch.setattr(os, "fsync", watched)
    write_atomic(path, b"x")
    assert order == [("file", False), ("folder", True)]


def test_new_folders_are_synced_where_they_got_their_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[Path] = []
    monkeypatch.setattr("polishd.util.files.sync_folder", synced.append)
    make_folder(tmp_path / "a" / "b", mode=0o700)
    make_folder(tmp_path / "a" / "b")
    assert sorted(synced) == [tmp_path, tmp_path / "a"]
    assert (tmp_path / "a" / "b").stat().st_mode & 0o777 == 0o700


def test_missing_folder_is_the_callers_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        write_atomic(tmp_path / "no" / "file", b"")


def test_a_device_stays_one(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(OSError, match="no file"):
        write_atomic(pipe, b"new")
    assert pipe.is_fifo()
    assert [path.name for path in tmp_path.iterdir()] == ["pipe"]


def test_what_is_written_can_be_read_back_before_it_has_its_name(tmp_path: Path) -> None:
    with whole_file(tmp_path / "a") as file:
        file.write(b"new")
        file.seek(0)
        assert file.read() == b"new"
        assert not (tmp_path / "a").exists()
    assert (tmp_path / "a").read_bytes() == b"new"


@pytest.mark.parametrize(("number", "raised"), [(errno.EINVAL, False), (errno.ENOTSUP, False), (errno.EIO, True)])
def test_a_share_that_syncs_no_folders_is_no_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, raised: bool
) -> None:
    def refuse(_: int) -> None:
        raise OSError(number, os.strerror(number))

    closed: list[int] = []
    plain = os.close
    monkeypatch.setattr(os, "close", lambda handle: (closed.append(handle), plain(handle)))
    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(OSError, match=os.strerror(number)) if raised else contextlib.nullcontext():
        sync_folder(tmp_path)
    assert len(closed) == 1, "no handle stays open"


# files that people write


def test_a_byte_order_mark_and_the_line_ends_of_other_systems_are_no_content(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_bytes(b"\xef\xbb\xbfa = 1\r\nb = '\xc3\xa4'\r\n")
    assert toml_text(path) == "a = 1\nb = 'ä'\n"


def test_a_text_of_another_encoding_is_refused_with_its_first_bad_byte(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_bytes(b"a = '\xe4'\n")
    with pytest.raises(ConfigError, match=re.escape(f"{path}: is not UTF-8 text (byte 5); save it as UTF-8")):
        toml_text(path)


def test_an_unreadable_file_is_refused_with_the_error_of_the_system(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=re.escape(f"{tmp_path}: cannot be read: Is a directory; name a TOML file")):
        toml_text(tmp_path)


# files that a user names may be none


@pytest.mark.parametrize("device", ["/dev/zero", "/dev/null", "/dev/tty"])
def test_a_device_is_refused_before_it_is_read(device: str) -> None:
    with pytest.raises(ConfigError, match=f"^{device}: cannot be read: it is a device, not a file; name a TOML file$"):
        toml_text(Path(device))


def test_a_pipe_is_read_as_a_file_is(tmp_path: Path) -> None:
    pipe, content = tmp_path / "pipe", b"a = 1\n" * 20_000
    os.mkfifo(pipe)
    writer = threading.Thread(target=pipe.write_bytes, args=[content])
    writer.start()
    try:
        assert read_input(pipe) == content
    finally:
        writer.join()


@pytest.mark.parametrize("size", [3, 4, 5])
def test_no_more_is_read_than_the_limit(tmp_path: Path, size: int) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"x" * (size << 20))
    read_end, write_end = os.pipe()
    with path.open("rb") as file, os.fdopen(read_end, "rb") as pipe:
        writer = threading.Thread(target=_write_all, args=[write_end, path.read_bytes()])
        writer.start()
        for source in (file, pipe):
            if size > 4:
                with pytest.raises(OSError, match="it is larger than 4 MiB"):
                    read_all(source, 4 << 20)
            else:
                assert len(read_all(source, 4 << 20)) == size << 20
    writer.join()  # where not all was read, its pipe is closed


def test_reading_ends_where_the_limit_is_passed(tmp_path: Path) -> None:
    """A pipe has no size: one that never ends would fill the memory."""
    read_end, write_end = os.pipe()
    with os.fdopen(read_end, "rb") as pipe:
        writer = threading.Thread(target=_write_all, args=[write_end, b"x" * (8 << 20)])
        writer.start()
        with pytest.raises(OSError, match="it is larger than 1 MiB"):
            read_all(pipe, 1 << 20)
        assert len(pipe.read()) >= 4 << 20, "the rest was left"
    writer.join()


def _write_all(handle: int, content: bytes) -> None:
    with contextlib.suppress(BrokenPipeError), os.fdopen(handle, "wb", buffering=0) as file:
        file.write(content)


def test_a_file_that_can_be_written_is_known_beforehand(tmp_path: Path) -> None:
    require_writable_file(tmp_path / "new.png")
    (tmp_path / "old.png").touch()
    require_writable_file(tmp_path / "old.png")
    with pytest.raises(ConfigError, match="none: is not a folder; make it"):
        require_writable_file(tmp_path / "none" / "new.png")
    with pytest.raises(ConfigError, match="is there, and is no regular file; name another"):
        require_writable_file(tmp_path)


# what others see meanwhile


def test_a_file_needs_room_in_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(folder: Path) -> None:
        raise ConfigError(f"{folder}: cannot be written: no space")

    monkeypatch.setattr("polishd.util.files.require_writable", full)
    with pytest.raises(ConfigError, match=f"^{tmp_path}: cannot be written"):
        require_writable_file(tmp_path / "new.png")


def test_what_is_not_whole_yet_lies_beside_it_hidden_and_its_owners_alone(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    with whole_file(path, 0o640) as file:
        file.write(b"x")
        (beside,) = tmp_path.iterdir()
        assert beside.name.startswith(".a.toml.")
        assert beside.suffix == ".tmp"
        assert beside.stat().st_mode & 0o777 == 0o640
        assert not path.exists()
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_in_its_place_is_refused_and_nothing_is_left(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    with pytest.raises(OSError, match="it is there, and is no file") as raised:
        write_atomic(tmp_path / "a", b"x")
    assert raised.value.errno == errno.EINVAL
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_only_a_folder_is_synced_as_one(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("")
    with pytest.raises(NotADirectoryError):
        sync_folder(tmp_path / "a")


def test_a_folder_is_like_any_that_its_owner_makes(tmp_path: Path) -> None:
    make_folder(tmp_path / "ours")
    (tmp_path / "any").mkdir()
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "any").stat().st_mode


def test_that_files_can_be_written_is_tried_where_they_will_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[str] = []
    plain = tempfile.TemporaryFile

    def temporary(*, prefix: str, dir: Path) -> object:  # noqa: A002
        tried.append(str(dir))
        return plain(prefix=prefix, dir=dir)

    monkeypatch.setattr(tempfile, "TemporaryFile", temporary)
    require_writable(tmp_path / "not" / "there" / "yet")
    require_writable(tmp_path)
    assert tried == [str(tmp_path)] * 2
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("gone", [False, True])
def test_what_ends_the_writing_comes_out_as_itself(tmp_path: Path, gone: bool) -> None:
    (tmp_path / "a").write_text("old")

    def write() -> None:
        with whole_file(tmp_path / "a") as file:
            file.write(b"new")
            if gone:
                (beside,) = tmp_path.glob(".a.*")
                beside.unlink()
            raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        write()
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a", "old")]


def test_all_of_the_content_is_there_when_it_is_made_durable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sizes: list[int] = []
    plain = os.fsync

    def fsync(handle: int) -> None:
        if not Path(f"/proc/self/fd/{handle}").is_dir():
            sizes.append(os.fstat(handle).st_size)
        plain(handle)

    monkeypatch.setattr(os, "fsync", fsync)
    write_atomic(tmp_path / "a", b"five!")
    assert sizes == [5]


OPEN = (0o640, 0o660, 0o662, 0o604, 0o606, 0o620, 0o644, 0o610)


@pytest.mark.parametrize("mode", OPEN)
def test_a_secret_that_group_or_others_may_read_or_change_is_refused_with_what_to_run(
    tmp_path: Path, mode: int
) -> None:
    path = tmp_path / "a token"
    path.write_text("s3cret\n")
    path.chmod(mode)
    run = re.escape(f"Run: chmod 600 '{path}'")
    with pytest.raises(ConfigError, match=rf"^'file:a token': mode {mode:04o} of .*{run}$") as refused:
        read_secret("file:a token", tmp_path)
    assert "s3cret" not in str(refused.value)
    path.chmod(0o600)
    assert read_secret("file:a token", tmp_path) == "s3cret"
    path.chmod(0o400)
    assert read_secret("file:a token", tmp_path) == "s3cret"


class Keys(BaseModel):
    token: SecretPlace


@pytest.mark.parametrize("wrong", ["s3cret", "file:", "env: ", "http:s3cret", 7, None])
def test_a_config_that_holds_a_secret_is_refused_without_repeating_it(wrong: Any) -> None:
    with pytest.raises(ValidationError, match=r"say where it is kept: \"file:NAME\" .* or \"env:VARIABLE\"") as refused:
        Keys(token=wrong)
    assert "s3cret" not in refused.value.errors()[0]["msg"]


def test_a_place_of_a_secret_stays_as_it_is() -> None:
    assert [Keys(token=place).token for place in ("file:a token", "env:TOKEN")] == ["file:a token", "env:TOKEN"]


def test_a_secret_that_cannot_be_read_is_refused_with_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "token"
    with pytest.raises(ConfigError, match=r"^'file:token': cannot be read: .*No such file .*; write the secret there$"):
        read_secret("file:token", tmp_path)
    for content, what in (
        (b"s3cret \xff", r"^'file:token': .*token is no UTF-8 text; write the secret there$"),
        (b" \n", r"^'file:token': holds no secret \(one line of text\)"),
        (b"two\nlines", r"^'file:token': holds no secret \(one line of text\)"),
    ):
        path.write_bytes(content)
        path.chmod(0o600)
        with pytest.raises(ConfigError, match=what) as refused:
            read_secret("file:token", tmp_path)
        assert "s3cret" not in str(refused.value)
    monkeypatch.delenv("TOKEN", raising=False)
    with pytest.raises(ConfigError, match=r"^'env:TOKEN': holds no secret"):
        read_secret("env:TOKEN", tmp_path)
    monkeypatch.setenv("TOKEN", " s3cret\n")
    assert read_secret("env:TOKEN", tmp_path) == "s3cret"


def test_a_log_has_no_secret() -> None:
    assert redact_secrets("GET /?a=s3cret&b=p4ss s3cret", "s3cret", "", "p4ss") == "GET /?a=***&b=*** ***"
    assert redact_secrets("nothing", "") == "nothing"


def test_a_new_file_takes_the_place_of_none_without_force(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    require_new_file(path, force=False)
    path.touch()
    with pytest.raises(ConfigError, match=r"cell\.toml: exists already; name another file, or say --force"):
        require_new_file(path, force=False)
    require_new_file(path, force=True)


def test_a_new_folder_is_none_that_holds_anything(tmp_path: Path) -> None:
    folder, file = tmp_path / "cell", tmp_path / "file"
    require_new(folder)
    folder.mkdir()
    require_new(folder)
    (folder / "a").touch()
    file.touch()
    for taken in (folder, file):
        with pytest.raises(ConfigError, match="exists already; name a new folder with --out"):
            require_new(taken)


def test_what_to_run_takes_nothing_from_the_owner(tmp_path: Path) -> None:
    path = tmp_path / "token"
    path.touch()
    path.chmod(0o440)
    with pytest.raises(ConfigError, match=r"Run: chmod 400 "):
        require_private(path)


@pytest.mark.parametrize("mode", OPEN)
def test_users_whom_others_could_add_or_read_are_refused(tmp_path: Path, mode: int) -> None:
    users = UserFile(tmp_path / "web-users.json")
    token = users.add("anna", Role.WATCH)
    users.path.chmod(mode)
    with pytest.raises(ConfigError, match=r"Run: chmod 600 "):
        users.of_token(token)
    users.path.chmod(0o600)
    assert users.of_token(token) is not None


def test_a_worker_inherits_what_it_needs_and_no_secret(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", "/somewhere")
    monkeypatch.setenv("MAIL_PASSWORD", "s3cret")
    found = environment_without_secrets({"OMP_NUM_THREADS": "1"})
    assert (found["PYTHONPATH"], found["OMP_NUM_THREADS"]) == ("/somewhere", "1")
    assert "PATH" in found
    assert "s3cret" not in found.values()
