"""Files from outside: a limit holds whatever the file system says, and nothing waits for a pipe."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from candaemon.files.bounded import read_bounded


def _refused(path: Path, longest: int, *, follow: bool = True) -> int | None:
    with pytest.raises(OSError) as caught:  # noqa: PT011 - its number is what is tested
        read_bounded(path, longest, follow=follow)
    assert caught.value.strerror
    return caught.value.errno


def test_a_file_at_its_limit_is_read_and_one_beyond_is_not(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"x" * 1000)
    assert read_bounded(path, 1000) == b"x" * 1000
    assert _refused(path, 999) == errno.EFBIG


def test_a_file_without_a_length_has_the_same_limit() -> None:
    assert _refused(Path("/proc/self/status"), 10) == errno.EFBIG


def test_a_pipe_that_nobody_writes_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert _refused(tmp_path / "pipe", 10) == errno.EINVAL
    assert _refused(tmp_path, 10) == errno.EISDIR


def test_a_link_is_refused_where_none_may_be(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"x")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    assert read_bounded(tmp_path / "link", 1) == b"x"
    assert _refused(tmp_path / "link", 1, follow=False) == errno.ELOOP
